"""Tables of figures on a terminal: whole words, units and numbers, in 80 columns."""

import pytest

import small_results
from arrive.commands.energy import print_energy
from arrive.commands.gait import print_gait


@pytest.fixture
def printed(capsys, monkeypatch):
    """The lines that a table prints on a terminal of 80 columns."""
    monkeypatch.setenv("COLUMNS", "80")

    def lines(show, content) -> list[str]:
        show(content)
        found = capsys.readouterr().out.splitlines()
        assert max(map(len, found)) <= 80
        assert "…" not in "".join(found)
        return [" ".join(line.split()) for line in found]

    return lines


def test_a_gait_in_80_columns(printed):
    _, head, trot, none = printed(print_gait, small_results.gait()["policies"][0])
    assert head == "given gait m/s Hz stride [m] duty LF RH [%] travel fell"
    assert trot == "1 trot 1.00±0.10 2.00±0.10 0.50±0.10 0.50 0 50 +1° 0"
    assert none == "1 +90° does not walk 50"


def test_energy_in_80_columns(printed):
    _, *head, walked, fallen = printed(print_energy, small_results.energy()["policies"][0])
    assert {"[N²m²s/m]", "[J/m]", "[s]", "CoT", "stood"} <= set(" ".join(head).split())
    assert walked == "0.5 0.500±0.010 60.0±1.0 1.00±0.10 1.00±0.10 1.00±0.10 1.00±0.10 0 0"
    assert fallen == "1 - - - - - - 50 0"
