"""The stick on the page: its HTML, and the parser of the text that it sends."""

import html
from pathlib import Path

SCRIPT = Path(__file__).with_name("stick.js")
STYLE = Path(__file__).with_name("page.css")
CENTRE = "0.00 0.00"
"""The text of a centred stick."""
PIXEL = "data:image/gif;base64,R0lGODlhAQABAAAAACwAAAAAAQABAAA="
"""A transparent image. Browsers do not run scripts in inserted HTML, but they run an image's `onload`."""


def stick_html() -> str:
    """The pad with its knob, and the script that reads it."""
    script = html.escape(f"({SCRIPT.read_text()})(this.previousElementSibling)", quote=True)
    return f"""
<div style="display:flex;justify-content:center;padding:0.4em">
  <svg data-arrive-pad width="132" height="132" viewBox="-66 -66 132 132" style="touch-action:none;cursor:grab">
    <circle r="64" fill="rgba(128,128,128,0.14)" stroke="rgba(128,128,128,0.5)"/>
    <path d="M0-58l6 9h-12z M0 58l6-9h-12z M-58 0l9 6v-12z M58 0l-9 6v-12z" fill="rgba(128,128,128,0.6)"/>
    <g data-arrive-knob><circle r="18" fill="rgb(224,122,31)"/></g>
  </svg>
  <img src="{PIXEL}" alt="" style="display:none" onload="{script}"/>
</div>"""


def parse_stick(text: str) -> tuple[float, float] | None:
    """Forward and left, -1 to 1, from the stick's text; None if it is malformed or out of range."""
    try:
        forward, left = (float(word) for word in text.split())
    except ValueError:
        return None
    return (forward, left) if abs(forward) <= 1.0 and abs(left) <= 1.0 else None


def page_html() -> str:
    """CSS for what viser has no setting for."""
    return f"<style>{STYLE.read_text()}</style>"
