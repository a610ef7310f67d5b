"""Options that are fields of dataclasses, and flags: what typer makes of them."""

from dataclasses import dataclass
from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

from gridslam.cli.options import flag, unpacked

SEEN = []


@dataclass(frozen=True)
class Size:
    width: Annotated[int, typer.Option(min=1)]
    height: int = 3


@dataclass(frozen=True)
class Look:
    plain: Annotated[bool, flag("--plain", "without colours")] = False


def draw(context: typer.Context, name: str, *, size: Size, shade: str = "dark", look: Look) -> None:
    """Draw something."""
    SEEN.append((context.params["height"], name, size, shade, look))


@pytest.fixture
def invoke():
    app = typer.Typer()
    app.command()(unpacked(draw))

    def call(*arguments):
        SEEN.clear()
        return CliRunner().invoke(app, arguments)

    return call


def test_fields_are_options_and_arrive_as_their_dataclass(invoke):
    assert invoke("it", "--width", "2", "--plain").exit_code == 0
    assert SEEN == [(3, "it", Size(2, 3), "dark", Look(True))]


@pytest.mark.parametrize("wrong", [["it"], ["it", "--width", "0"], ["it", "--width", "2", "--size", "3"]])
def test_fields_are_checked_as_options_are(invoke, wrong):
    assert invoke(*wrong).exit_code == 2
    assert not SEEN


def test_help_shows_options_in_the_order_of_fields_and_flags_without_a_value(invoke):
    text = invoke("--help").output
    assert "Draw something." in text
    places = [text.index(f"--{name}") for name in ("width", "height", "shade", "plain")]
    assert places == sorted(places)
    row = next(line for line in text.splitlines() if "--plain" in line)
    assert "without colours" in row
    assert "bool" not in row.lower()
