"""The report as one HTML page that needs nothing from elsewhere: charts and pictures are data URIs."""

import base64
import html
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from PIL import Image

from arrive.errors import ArriveError
from arrive.report.charts import color_of, difficulty_chart, reach_chart, speed_chart, training_chart
from arrive.report.diagnosis import why_stuck
from arrive.report.experiments import (
    MARKS,
    Results,
    claim,
    energy_section,
    gait_section,
    stability_section,
    window_section,
)
from arrive.report.markup import chart, code, command_line, label, missing, symbol
from arrive.report.reach import ground_words, protocol_words, waiting_words
from arrive.report.records import Run

TASK_NAMES = {
    "velocity": "velocity tracking",
    "continuous": "continuous position tracking",
    "final": "final position tracking",
}
TITLE = "The paper's experiments, measured here"
STRIP_WIDTH = 1400
"""Picture strips are shrunk to this [pixels]."""
WORDS = {"holds": "higher", "fails": "not higher", "open": "neither solves a level"}
LIMIT_NAMES = {"max_at_95": "95 %", "max_at_80": "80 %", "max_at_50": "50 %"}

CSS = (Path(__file__).parent / "page.css").read_text(encoding="utf-8")


SECTIONS = {
    "claims": "Claims",
    "table": "Table I",
    "reach": "Distance, direction, time",
    "energy": "Energy",
    "gait": "Gaits",
    "stability": "Stability",
    "window": "T<sub>r</sub>",
    "training": "Training",
    "made": "How it was made",
}
"""What one can jump to."""


NOTHING = Results()


def make_page(runs: Sequence[Run], content: dict[str, Any], results: Results = NOTHING) -> str:
    """The page with the figures of `report.make_content` and the measurements outside the runs' folders."""
    sections = [
        _head(runs, content),
        _claims(content["relations"]),
        _table(content["table"]),
        _difficulty(runs),
        _reach(runs),
        _usage(runs),
        energy_section(runs, results.energy),
        gait_section(runs, results.gait),
        stability_section(results.stability),
        window_section(results.window),
        _strips(runs),
        _training(runs),
        _origins(content),
    ]
    body = "\n".join(section for section in sections if section)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{TITLE}</title><style>{CSS}</style></head>\n<body>{body}</body></html>\n"
    )


def _head(runs: Sequence[Run], content: dict[str, Any]) -> str:
    measured = [run for run in runs if run.difficulty]
    levels = {level["episodes"] for run in measured for f in run.families.values() for level in f["levels"]}
    total = sum(entry["episodes"] for row in content["table"] for entry in row["ours"])
    behind = f"{' or '.join(f'{n:,}' for n in sorted(levels))} episodes behind every point, {total:,} in all"
    return (
        f"<h1>{TITLE}</h1>"
        "<p class=soft>Robots trained to do three things: "
        f"{'; '.join(f'{symbol(task)} {name}' for task, name in TASK_NAMES.items())}. Paper: Rudin, Hoeller, "
        "Bjelonic, Hutter, Advanced Skills by Learning Locomotion and Local Navigation End-to-End (2022). "
        f"Here: {_policies(len(measured))}, {behind if measured else 'nothing measured yet'}.</p>"
        f"<nav>{' '.join(f'<a href=#{name}>{text}</a>' for name, text in SECTIONS.items())}</nav>"
    )


def _policies(count: int) -> str:
    return "1 measured policy" if count == 1 else f"{count} measured policies"


def _claims(relations: Sequence[dict[str, Any]]) -> str:
    cards = []
    for relation in relations:
        rows = [
            f"<li>{html.escape(family)}: {WORDS[v['verdict']]} <span class=small>({_compared(v)})</span></li>"
            for family, v in relation["families"].items()
        ]
        listed = "".join(rows) or "<li>not measured: both tasks must be measured on the same terrain</li>"
        verdict = f"<span class=mark>{MARKS[relation['verdict']]}</span>"
        title = f"<h3 class={relation['verdict']}>{verdict}{claim(relation['claim'])}</h3>"
        cards.append(f"<div class=claim>{title}<ul>{listed}</ul></div>")
    return "<h2 id=claims>What the paper claims of terrain</h2><div class=claims>" + "".join(cards) + "</div>"


def _compared(verdict: dict[str, Any]) -> str:
    first, second = ("none" if value is None else f"{value:g}" for value in verdict["values"])
    return f"{first} against {second} at {LIMIT_NAMES[verdict['by']]}"


def _table(table: Sequence[dict[str, Any]]) -> str:
    tasks = list(dict.fromkeys([*TASK_NAMES, *(entry["task"] for row in table for entry in row["ours"])]))
    head = "".join(
        f"<th class=figure>{symbol(task)} <span class=soft>{TASK_NAMES.get(task, '')}</span></th>" for task in tasks
    )
    rows = "".join(_row(row, tasks) for row in table)
    return (
        "<h2 id=table>Maximum difficulty solved in 95 % of the episodes (Table I)</h2>"
        "<p class=soft>Grey: the paper, trained for 2,000 iterations of 196,608 samples. Coloured: measured here, the "
        "largest value up to which every level is solved. Bars of a row share one scale.</p>"
        f"<table class=limits><tr><th>terrain</th>{head}</tr>{rows}</table>"
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
        who = f"<span class=who>{symbol(task)}</span>"
        cells.append(f"<td>{who}{''.join(bars) or '<span class=small>not in the paper, not measured</span>'}</td>")
    unit = html.escape(f"{row['parameter']} [{row['unit']}]")
    parameter = f"<br><span class=small>{unit}</span>" if row["unit"] else ""
    return f"<tr><td><b>{html.escape(row['family'])}</b>{parameter}</td>{''.join(cells)}</tr>"


def _bar(kind: str, value: float | None, top: float, unit: str, color: str) -> str:
    text = "none" if value is None else (f"{value:g} {unit}" if unit else "solved")
    share = (value / top if unit else 1.0) if value is not None else 0.0
    fill = f'<i style="width:{100 * share:.1f}%;background:{color}"></i>'
    text = f"paper {text}" if kind == "paper" else text
    return f"<div class='bar {kind}'><div class=track>{fill}</div><span>{html.escape(text)}</span></div>"


def _behind(entry: dict[str, Any], unit: str) -> str:
    looser = ", ".join(f"{LIMIT_NAMES[name]}: {_value(entry[name], unit)}" for name in ("max_at_80", "max_at_50"))
    levels = "1 level" if entry["levels"] == 1 else f"{entry['levels']} levels"
    behind = f"{html.escape(entry['run'])}, {levels}, {entry['episodes']:,} episodes"
    return f"<div class=small>{html.escape(looser)}<br>{behind}</div>"


def _value(value: float | None, unit: str) -> str:
    return "none" if value is None else f"{value:g} {unit}".strip() if unit else "solved"


def _difficulty(runs: Sequence[Run]) -> str:
    if not any(run.results() for run in runs):
        commands = (command_line("eval", "--protocol", "difficulty", run.name) for run in runs)
        return "<h2>Success against difficulty</h2>" + missing("No run was measured.", *commands)
    families = dict.fromkeys(name for run in runs for name in run.results())
    sentences = "".join(
        f"<li>{label(run.task, run.name)} {html.escape(why_stuck(run.results()[name]))}</li>"
        for name in families
        for run in runs
        if name in run.results()
    )
    return (
        "<h2>Success against difficulty, and where it ends</h2>"
        "<p class=soft>Bands: 95 % Wilson intervals. Dotted lines: the paper's maximum in the colour of the task.</p>"
        f"{chart(lambda columns: difficulty_chart(runs, columns), 'success against difficulty')}<ul>{sentences}</ul>"
    )


def _reach(runs: Sequence[Run]) -> str:
    """Success by distance, direction and time given."""
    head = "<h2 id=reach>Success by distance, direction and time given</h2>"
    measured = [(run, run.reach) for run in runs if run.reach]
    if not measured:
        commands = (command_line("eval", "--protocol", "reach", run.name) for run in runs)
        return head + missing("No run was measured at other targets.", *commands)
    items, made = [], []
    for run, reach in measured:
        for name, entry in reach["families"].items():
            words = f"{html.escape(ground_words(name, entry))}: {html.escape(waiting_words(entry['waiting']))}."
            compared = html.escape(protocol_words(run.difficulty, name, entry))
            items.append(f"<li>{label(run.task, run.name)} {words} {compared}</li>")
        made.append(f"{code(_reach_command(run, reach))}, measured by {html.escape(reach['commit'])}")
    drawn, protocol = [run for run, _ in measured], measured[0][1]["protocol"]
    return (
        f"{head}<p class=soft>The paper does not measure this. Success is {html.escape(protocol['success'])}. "
        "Directions are counterclockwise from the heading at the start, each with all distances in equal parts. A "
        "target in a hole is moved to the next valid place behind it. Bands: 95 % Wilson intervals. Each policy's card "
        "compares the times given.</p>"
        f"{chart(lambda columns: reach_chart(drawn, columns), 'success by distance and direction')}"
        f"<ul>{''.join(items)}</ul><p class=made>{'<br>'.join(made)}</p>"
    )


def _reach_command(run: Run, reach: dict[str, Any]) -> str:
    protocol = reach["protocol"]
    lists = {"--target-distance": "distances_m", "--direction": "directions_deg", "--time": "times_s"}
    grounds = (ground_words(name, entry).split(" ") for name, entry in reach["families"].items())
    terrain = ",".join("=".join(words[:2]) for words in grounds)
    options = [word for option, key in lists.items() for word in (option, _joined(protocol[key]))]
    return command_line(
        *("eval", run.name, "--terrain", terrain, *options, "--layout", protocol["layout"]),
        *("--episodes", protocol["episodes"], "--seed", protocol["seed"]),
    )


def _joined(values: Sequence[float]) -> str:
    return ",".join(f"{value:g}" for value in values)


def _usage(runs: Sequence[Run]) -> str:
    rows = []
    for family in dict.fromkeys(name for run in runs for name in run.results()):
        for run in (run for run in runs if family in run.usage):
            easiest = run.usage[family][0]
            if "arrival_time_s" in easiest:
                time, path = easiest["arrival_time_s"], easiest["path_length_m"]
                rows.append(
                    f"<tr><td>{label(run.task, run.name)}</td><td>{html.escape(family)}</td>"
                    f"<td>{time[1]:.2f} s <span class=small>({time[0]:.2f} to {time[2]:.2f})</span></td>"
                    f"<td>{path[1]:.2f} m <span class=small>({path[0]:.2f} to {path[2]:.2f})</span></td>"
                    f"<td>{easiest['episodes']:,}</td></tr>"
                )
    if not rows:
        return ""
    trial = next(run.difficulty["protocol"]["trial"] for run in runs if run.difficulty)
    return (
        "<h2>Use of the time</h2><p class=soft>Successful episodes at the easiest level of each terrain; "
        f"{trial['duration_s']:g} s were given. Arrival is the first moment within reach of the target (V: "
        f"{trial['walk']:g} m walked), path the horizontal way until then; median and quartiles. Chart: mean "
        "speed; dotted: median arrival.</p>"
        f"{chart(lambda columns: speed_chart(runs, columns), 'speed over time')}"
        "<div class=wide><table><tr><th>policy</th><th>easiest</th><th>arrival time</th><th>path length</th>"
        f"<th>episodes</th></tr>{''.join(rows)}</table></div>"
    )


def _strips(runs: Sequence[Run]) -> str:
    figures = [
        f"<figure><figcaption>{label(run.task, run.name)}, {html.escape(family)}</figcaption>{_picture(path)}</figure>"
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
        "<h2 id=training>Training</h2><p class=soft>Success is each task's own: at the target when the time is over, "
        "or for V more than 4 m or half of the commanded distance walked without a crash. Each task has its own rule "
        "for when levels rise.</p>"
        f"{chart(lambda columns: training_chart(runs, columns), 'training curves', 2)}"
    )


def _origins(content: dict[str, Any]) -> str:
    rows = []
    for run in content["runs"]:
        minutes = f", {run['training_s'] / 60:.0f} min" if run["training_s"] else ""
        measured = f"<br><code>{html.escape(run['eval_command'])}</code>" if run["eval_command"] else ""
        at = f"<br>measured by {html.escape(run['difficulty']['commit'])}" if run["difficulty"] else "<br>not measured"
        rows.append(
            f"<tr><td>{symbol(run['task'])} ({html.escape(run['name'])})<br><span class=small>"
            f"{run['amount']}{minutes}</span></td>"
            f"<td>{run['seed']}</td><td><span class=small>trained by {html.escape(run['commit'])}{at}</span></td>"
            f"<td><code>{html.escape(run['train_command'])}</code>{measured}</td></tr>"
        )
    protocol = next((run["difficulty"]["protocol"] for run in content["runs"] if run["difficulty"]), None)
    notes = _protocol(protocol) if protocol else ""
    return (
        f"<h2 id=made>How it was made</h2>{notes}<div class=wide><table><tr><th>run</th><th>seed</th><th>commit</th>"
        f"<th>commands</th></tr>{''.join(rows)}</table></div>"
        f"<p class=small>Page written by {html.escape(content['commit'])}.</p>"
    )


def _protocol(protocol: dict[str, Any]) -> str:
    trial, start = protocol["trial"], protocol["randomisation"]
    return (
        f"<p class=soft>Protocol: {trial['duration_s']:g} s to cross {protocol['terrain_m']:g} m of terrain. "
        f"{symbol('final')} and {symbol('continuous')} get a target {trial['target'][0]:g} m ahead and must be "
        f"within {protocol['arrival_radius_m']:g} m of it at the end, without a crash. V must walk forward at "
        f"{trial['speed']:g} m/s, facing along the terrain, and must get farther than {trial['walk']:g} m, even if it "
        f"crashes afterwards. Start heading ±{start['start_yaw_rad']:g} rad, position ±{start['start_offset']:g} m, "
        f"velocity ±{start['start_speed']:g} m/s and rad/s, joints ±{100 * start['start_joint_scale']:g} %; friction "
        f"{start['friction'][0]:g} to {start['friction'][1]:g}, payload {start['payload_kg'][0]:g} to "
        f"{start['payload_kg'][1]:g} kg, no pushes, sensor noise {'on' if protocol['observation_noise'] else 'off'}; "
        f"{protocol['worlds_per_level']} worlds per level on seeds that training never saw. "
        "The policies act without exploration noise. "
        f"{html.escape(protocol['note'][:1].upper() + protocol['note'][1:])}.</p>"
    )


def _picture(path: Path) -> str:
    """A strip, shrunk, as a JPEG: a page of many would be too large to send otherwise."""
    data = io.BytesIO()
    try:
        with Image.open(path) as image:
            size = (min(STRIP_WIDTH, image.width), max(round(image.height * min(STRIP_WIDTH / image.width, 1.0)), 1))
            image.convert("RGB").resize(size, Image.Resampling.LANCZOS).save(data, "JPEG", quality=85)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:  # whatever a damaged PNG raises
        raise ArriveError(f"cannot read the picture {path}: {error}. Delete it, or evaluate again.") from error
    return f'<img alt="{html.escape(path.stem)}" src="data:image/jpeg;base64,{_base64(data.getvalue())}">'


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()
