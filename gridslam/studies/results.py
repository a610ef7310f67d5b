"""What is left of a study when it ends: tables and figures, always of the same runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from gridslam.io.files import cannot_write
from gridslam.studies import plots
from gridslam.studies.batches import Batch
from gridslam.studies.tables import content, run_rows, write_tables


def write_results(
    directory: Path, found: Sequence[Batch], form: str = "png", width: float = plots.WHOLE_IN
) -> None:
    """Write the tables of a study and draw its figures.

    Where other runs were told of here before, their figures go first, so that whatever stops this leaves no
    figure beside a table of other runs; those of another form are drawn again, too, in the usual width, since
    the report shows them.

    Parameters
    ----------
    directory : Path
    found : sequence of Batch
    form : str
        Of the figures: ``png``, ``pdf`` or ``svg``.
    width : float, inches

    Raises
    ------
    InputError
        They can't be written.
    """
    forms = {form: width}
    if _told(directory) != content(run_rows(found)):
        for path in plots.drawn_before(directory, found):
            try:
                path.unlink()
            except OSError as error:
                raise cannot_write(path, error) from error
            forms.setdefault(path.suffix[1:], plots.WHOLE_IN)
    write_tables(directory, found)
    for one, wide in forms.items():
        plots.draw_study(directory, found, one, wide)


def _told(directory: Path) -> bytes | None:
    """The table of runs that is there."""
    try:
        return (directory / "runs.csv").read_bytes()
    except OSError:
        return None
