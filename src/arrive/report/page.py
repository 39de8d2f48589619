"""The report as one HTML page that needs nothing from elsewhere: charts and pictures are data URIs."""

import base64
import html
import io
from collections.abc import Sequence
from typing import Any

from PIL import Image

from arrive.report.charts import color_of, difficulty_chart, speed_chart, training_chart
from arrive.report.diagnosis import why_stuck
from arrive.report.records import SYMBOLS, Run

TASK_NAMES = {
    "velocity": "velocity tracking",
    "continuous": "continuous position tracking",
    "final": "final position tracking",
}
STRIP_WIDTH = 1400
"""Picture strips are shrunk to this [pixels]."""
MARKS = {"holds": "✓", "fails": "✗", "open": "?"}
WORDS = {"holds": "holds here", "fails": "not yet", "open": "neither solves a level"}
LIMIT_NAMES = {"max_at_95": "95 %", "max_at_80": "80 %", "max_at_50": "50 %"}

CSS = """
:root { --ink: #1b1f24; --soft: #626a73; --line: #e3e6ea; --paper: #c3c8ce; }
* { box-sizing: border-box; }
body { font: 15px/1.5 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; color: var(--ink); margin: 0 auto;
  max-width: 1240px; padding: 28px 32px 60px; background: #fff; }
h1 { font-size: 27px; margin: 0 0 4px; } h2 { font-size: 19px; margin: 40px 0 4px; }
p { margin: 4px 0 12px; } .soft { color: var(--soft); font-size: 13.5px; }
sub { line-height: 0; font-size: 72%; }
.claims { display: grid; grid-template-columns: repeat(3, 1fr); gap: 14px; margin: 18px 0 6px; }
.claim { border: 1px solid var(--line); border-radius: 8px; padding: 12px 16px; }
.claim h3 { margin: 0 0 6px; font-size: 16px; } .claim ul { list-style: none; margin: 0; padding: 0; }
.claim li { padding: 1px 0; } .mark { display: inline-block; width: 20px; font-weight: 700; }
.holds { color: #14783c; } .fails { color: #b3261e; } .open { color: var(--soft); }
table { border-collapse: collapse; width: 100%; margin: 10px 0; }
th { text-align: left; font-weight: 600; border-bottom: 2px solid var(--ink); padding: 6px 10px;
  vertical-align: bottom; }
td { border-bottom: 1px solid var(--line); padding: 8px 10px; vertical-align: top; }
.figure { width: 27%; } .bar { display: flex; align-items: center; gap: 7px; height: 20px; white-space: nowrap; }
.bar i { display: block; height: 11px; border-radius: 2px; min-width: 2px; } .bar span { font-size: 13px; }
.bar.paper i { background: var(--paper); } .bar.paper span { color: var(--soft); }
.bar.ours span { font-weight: 600; } .track { width: 45%; flex: none; }
.small { font-size: 12.5px; color: var(--soft); } li .small { white-space: nowrap; }
img { display: block; max-width: 100%; } figure { margin: 12px 0 20px; }
figcaption { font-size: 13.5px; margin: 2px 0; }
code { font: 12.5px/1.45 ui-monospace, "DejaVu Sans Mono", monospace; overflow-wrap: anywhere; }
"""


def make_page(runs: Sequence[Run], content: dict[str, Any]) -> str:
    """The page of `report.make_content`'s figures."""
    sections = [
        _head(runs, content),
        _claims(content["relations"]),
        _table(content["table"]),
        _difficulty(runs),
        _usage(runs),
        _strips(runs),
        _training(runs),
        _origins(content),
    ]
    body = "\n".join(section for section in sections if section)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>How hard a terrain is still solved</title><style>{CSS}</style></head>\n<body>{body}</body></html>\n"
    )


def _head(runs: Sequence[Run], content: dict[str, Any]) -> str:
    measured = [run for run in runs if run.difficulty]
    levels = {
        level["episodes"] for run in measured for f in run.difficulty["families"].values() for level in f["levels"]
    }
    total = sum(entry["episodes"] for row in content["table"] for entry in row["ours"])
    behind = f"{' or '.join(f'{n:,}' for n in sorted(levels))} episodes behind every point, {total:,} in all"
    return (
        "<h1>How hard a terrain is still solved</h1>"
        "<p class=soft>The hardest terrain that robots cross in 95 % of the episodes, by what they were trained to "
        f"do: {'; '.join(f'{_symbol(task)} {name}' for task, name in TASK_NAMES.items())}. Paper: Rudin, Hoeller, "
        "Bjelonic, Hutter, Advanced Skills by Learning Locomotion and Local Navigation End-to-End (2022), Table I. "
        f"Here: {len(measured)} measured policies, {behind if measured else 'nothing measured yet'}.</p>"
    )


def _claims(relations: Sequence[dict[str, Any]]) -> str:
    cards = []
    for relation in relations:
        rows = [
            f"<li class={v['verdict']}><span class=mark>{MARKS[v['verdict']]}</span>{html.escape(family)}: "
            f"{WORDS[v['verdict']]} <span class=small>({_compared(v)})</span></li>"
            for family, v in relation["families"].items()
        ]
        listed = "".join(rows) or "<li class=open>not measured: it takes both tasks on one terrain</li>"
        cards.append(f"<div class=claim><h3>{_claim(relation['claim'])}</h3><ul>{listed}</ul></div>")
    return "<h2>What the paper claims</h2><div class=claims>" + "".join(cards) + "</div>"


def _claim(text: str) -> str:
    for task, symbol in SYMBOLS.items():
        text = text.replace(symbol, _symbol(task)) if "_" in symbol else text
    return text


def _compared(verdict: dict[str, Any]) -> str:
    first, second = ("none" if value is None else f"{value:g}" for value in verdict["values"])
    return f"{first} against {second} at {LIMIT_NAMES[verdict['by']]}"


def _table(table: Sequence[dict[str, Any]]) -> str:
    tasks = list(dict.fromkeys([*TASK_NAMES, *(entry["task"] for row in table for entry in row["ours"])]))
    head = "".join(
        f"<th class=figure>{_symbol(task)} <span class=soft>{TASK_NAMES.get(task, '')}</span></th>" for task in tasks
    )
    rows = "".join(_row(row, tasks) for row in table)
    return (
        "<h2>Maximum difficulty solved in 95 % of the episodes</h2>"
        "<p class=soft>Grey: the paper, trained for 2,000 iterations of 196,608 samples. Coloured: measured here, the "
        "largest value up to which every level is solved. Bars of a row share one scale.</p>"
        f"<table><tr><th>terrain</th>{head}</tr>{rows}</table>"
    )


def _row(row: dict[str, Any], tasks: Sequence[str]) -> str:
    paper = row["paper"] or {}
    ours = row["ours"]
    values = [*paper.values(), *(entry["hardest"] for entry in ours)]
    top = max((value for value in values if value), default=1.0)
    cells = []
    for task in tasks:
        bars = []
        if row["paper"] and task in paper:
            bars.append(_bar("paper", paper[task], top, row["unit"], "var(--paper)"))
        for entry in ours:
            if entry["task"] == task:
                bars += [
                    _bar("ours", entry["max_at_95"], top, row["unit"], color_of(task)),
                    _behind(entry, row["unit"]),
                ]
        cells.append(f"<td>{''.join(bars) or '<span class=small>not in the paper, not measured</span>'}</td>")
    parameter = f"<br><span class=small>{row['parameter']} [{row['unit']}]</span>" if row["unit"] else ""
    return f"<tr><td><b>{html.escape(row['family'])}</b>{parameter}</td>{''.join(cells)}</tr>"


def _bar(kind: str, value: float | None, top: float, unit: str, color: str) -> str:
    text = "none" if value is None else (f"{value:g} {unit}" if unit else "solved")
    share = (value / top if unit else 1.0) if value is not None else 0.0
    fill = f'<i style="width:{100 * share:.1f}%;background:{color}"></i>'
    text = f"paper {text}" if kind == "paper" else text
    return f"<div class='bar {kind}'><div class=track>{fill}</div><span>{text}</span></div>"


def _behind(entry: dict[str, Any], unit: str) -> str:
    looser = ", ".join(f"{LIMIT_NAMES[name]}: {_value(entry[name], unit)}" for name in ("max_at_80", "max_at_50"))
    levels = "1 level" if entry["levels"] == 1 else f"{entry['levels']} levels"
    return f"<div class=small>{looser}<br>{html.escape(entry['run'])}, {levels}, {entry['episodes']:,} episodes</div>"


def _value(value: float | None, unit: str) -> str:
    return "none" if value is None else f"{value:g} {unit}".strip() if unit else "solved"


def _difficulty(runs: Sequence[Run]) -> str:
    if not any(run.results() for run in runs):
        return ""
    families = dict.fromkeys(name for run in runs for name in run.results())
    sentences = "".join(
        f"<li>{_label(run)} {html.escape(why_stuck(run.results()[name]))}</li>"
        for name in families
        for run in runs
        if name in run.results()
    )
    return (
        "<h2>Success against difficulty, and where it ends</h2>"
        "<p class=soft>Bands: 95 % Wilson intervals. Dotted lines: the paper's maximum in the colour of the task.</p>"
        f"{_svg_image(difficulty_chart(runs), 'success against difficulty')}<ul>{sentences}</ul>"
    )


def _usage(runs: Sequence[Run]) -> str:
    rows = []
    for family in dict.fromkeys(name for run in runs for name in run.results()):
        for run in (run for run in runs if family in run.results()):
            easiest = run.difficulty["policy"]["usage"][family][0]
            if easiest["episodes"]:
                time, path = easiest["arrival_time_s"], easiest["path_length_m"]
                rows.append(
                    f"<tr><td>{_label(run)}</td><td>{html.escape(family)}</td>"
                    f"<td>{time[1]:.2f} s <span class=small>({time[0]:.2f} to {time[2]:.2f})</span></td>"
                    f"<td>{path[1]:.2f} m <span class=small>({path[0]:.2f} to {path[2]:.2f})</span></td>"
                    f"<td>{easiest['episodes']:,}</td></tr>"
                )
    if not rows:
        return ""
    return (
        "<h2>Use of the time</h2><p class=soft>Successful episodes at the easiest level of each terrain; 8 s were "
        "given. Arrival is the first moment within reach of the target (V: 4 m walked), path the horizontal way until "
        "then; median and quartiles. Chart: mean speed; dotted: median arrival.</p>"
        f"{_svg_image(speed_chart(runs), 'speed over time')}"
        "<table><tr><th>policy</th><th>easiest</th><th>arrival time</th><th>path length</th><th>episodes</th></tr>"
        f"{''.join(rows)}</table>"
    )


def _strips(runs: Sequence[Run]) -> str:
    figures = [
        f"<figure><figcaption>{_label(run)}, {html.escape(family)}</figcaption>{_picture(path)}</figure>"
        for family in dict.fromkeys(name for run in runs for name in run.pictures)
        for run in runs
        if (path := run.pictures.get(family))
    ]
    if not figures:
        return ""
    return (
        "<h2>What it looks like</h2><p class=soft>Of each terrain the hardest level whose first robot succeeded, or "
        f"else the easiest.</p>{''.join(figures)}"
    )


def _training(runs: Sequence[Run]) -> str:
    if not any(run.log for run in runs):
        return ""
    return (
        "<h2>Training</h2><p class=soft>Success is each task's own: at the target when the time is over, or for V half "
        "of the commanded distance walked without a crash. The tasks' levels rise by rules of their own.</p>"
        f"{_svg_image(training_chart(runs), 'training curves')}"
    )


def _origins(content: dict[str, Any]) -> str:
    rows = []
    for run in content["runs"]:
        minutes = f", {run['training_s'] / 60:.0f} min" if run["training_s"] else ""
        measured = f"<br><code>{html.escape(run['eval_command'])}</code>" if run["eval_command"] else ""
        at = f"<br>measured by {html.escape(run['difficulty']['commit'])}" if run["difficulty"] else "<br>not measured"
        rows.append(
            f"<tr><td>{_symbol(run['task'])} ({html.escape(run['name'])})<br><span class=small>"
            f"{run['amount']}{minutes}</span></td>"
            f"<td>{run['seed']}</td><td><span class=small>trained by {html.escape(run['commit'])}{at}</span></td>"
            f"<td><code>{html.escape(run['train_command'])}</code>{measured}</td></tr>"
        )
    protocol = next((run["difficulty"]["protocol"] for run in content["runs"] if run["difficulty"]), None)
    told = _protocol(protocol) if protocol else ""
    return (
        f"<h2>How it was made</h2>{told}<table><tr><th>run</th><th>seed</th><th>commit</th><th>commands</th></tr>"
        f"{''.join(rows)}</table><p class=small>Page written by {html.escape(content['commit'])}.</p>"
    )


def _protocol(protocol: dict[str, Any]) -> str:
    trial, start = protocol["trial"], protocol["randomisation"]
    return (
        f"<p class=soft>Protocol: {trial['duration_s']:g} s to cross {protocol['terrain_m']:g} m of terrain. "
        f"{_symbol('final')} and {_symbol('continuous')} get a target {trial['target'][0]:g} m ahead and must be "
        f"within {protocol['arrival_radius_m']:g} m of it at the end, without a crash. V is told to walk forward at "
        f"{trial['speed']:g} m/s, facing along the terrain, and must get farther than {trial['walk']:g} m, even if it "
        f"crashes afterwards. Start heading ±{start['start_yaw_rad']:g} rad, position ±{start['start_offset']:g} m, "
        f"velocity ±{start['start_speed']:g} m/s and rad/s, joints ±{100 * start['start_joint_scale']:g} %; friction "
        f"{start['friction'][0]:g} to {start['friction'][1]:g}, payload {start['payload_kg'][0]:g} to "
        f"{start['payload_kg'][1]:g} kg, no pushes, sensor noise {'on' if protocol['observation_noise'] else 'off'}; "
        f"{protocol['worlds_per_level']} worlds per level on seeds that training never saw. "
        "The policies act without exploration noise. "
        f"{html.escape(protocol['note'][0].upper() + protocol['note'][1:])}.</p>"
    )


def _symbol(task: str) -> str:
    letter, _, index = SYMBOLS.get(task, task).partition("_")
    subscript = f"<sub>{index}</sub>" if index else ""
    return f'<b style="color:{color_of(task)}">{html.escape(letter)}{subscript}</b>'


def _label(run: Run) -> str:
    return f"{_symbol(run.task)} ({html.escape(run.name)})"


def _svg_image(svg: str, alternative: str) -> str:
    return f'<img alt="{alternative}" src="data:image/svg+xml;base64,{_base64(svg.encode())}">'


def _picture(path) -> str:
    """A strip, shrunk, as a JPEG: a page of many would be too large to send otherwise."""
    with Image.open(path) as image:
        size = (min(STRIP_WIDTH, image.width), round(image.height * min(STRIP_WIDTH / image.width, 1.0)))
        data = io.BytesIO()
        image.convert("RGB").resize(size, Image.Resampling.LANCZOS).save(data, "JPEG", quality=85)
    return f'<img alt="{html.escape(path.stem)}" src="data:image/jpeg;base64,{_base64(data.getvalue())}">'


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()
