"""Writes docs/metrics.md from `arrive.learning.metrics`.

python scripts/metrics_reference.py           # writes
python scripts/metrics_reference.py --check   # exit status 1 where it is not up to date
"""

from pathlib import Path

from pages import write_or_check

from arrive.learning.metrics import METRICS

PAGE = Path(__file__).parent.parent / "docs" / "metrics.md"
HEAD = """# Logged metrics

Made from the code by `python scripts/metrics_reference.py`; change `src/arrive/learning/metrics.py`, not this page.

Every iteration is a row of `log.csv` and a step of TensorBoard. In training robots act with exploration noise, pushes
and randomisation, so success rates are lower than those of `arrive eval`. A share is a number from 0 to 1. An empty
cell means that there was nothing to measure.

| metric | unit | meaning |
|---|---|---|
"""


def page() -> str:
    """The page as Markdown."""
    return HEAD + "".join(f"| `{metric.name}` | {metric.unit} | {metric.meaning} |\n" for metric in METRICS)


if __name__ == "__main__":
    write_or_check({PAGE: page()})
