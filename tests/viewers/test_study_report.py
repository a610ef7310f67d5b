"""The page of a study: its summary and figures, and nothing that isn't a study's."""

import pytest

ROWS = """scene,filter.births,method,agent,runs,diverged,position_settled_rmse_m,heading_settled_rmse_deg
room,0.05,grid,agent1,2,0,0.0123,
room,0.2,grid,agent1,2,1,0.5,
"""
PIXEL = bytes.fromhex(
    "89504e470d0a1a0a0000000d4948445200000001000000010802000000907753de0000000c49444154789c63606060000000040001f6"
    "1738550000000049454e44ae426082"
)


@pytest.fixture
def study(tmp_path):
    folder = tmp_path / "births"
    (folder / "figures").mkdir(parents=True)
    (folder / "summary.csv").write_text(ROWS)
    (folder / "study.jsonl").write_text("{}\n")
    for kind in ("errors", "cdf"):
        (folder / "figures" / f"room-agent1-{kind}.png").write_bytes(PIXEL)
    return folder


def test_the_page_has_a_row_for_each_setting_and_the_figures(say, study):
    told = say("report", study)
    assert (told.code, told.out.strip()) == (0, f"wrote {study / 'report.html'}")
    page = (study / "report.html").read_text()
    assert page.count("<img") == 2
    assert page.index("Errors over the steps") < page.index("How errors are")
    assert "<td>0.05</td><td>2</td><td>0</td><td>1.23 cm</td>" in page
    assert "<td>0.2</td><td>2</td><td>1</td><td>50.00 cm</td>" in page
    assert "heading" not in page.split("<h2>")[0], "of which there is nothing"
    assert "http" not in page.replace("http-equiv", "")
    assert say("report", study).code == 0, "its own page is made again"


def test_a_figure_that_is_a_link_to_elsewhere_is_refused(say, study, tmp_path):
    (tmp_path / "secret.png").write_bytes(PIXEL)
    (study / "figures" / "room-agent1-map.png").symlink_to(tmp_path / "secret.png")
    told = say("report", study)
    assert (told.code, len(told.complaints)) == (2, 1)
    assert "room-agent1-map.png: found a link that leads out of the folder" in told.err
    assert not (study / "report.html").exists()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            ROWS.replace("0.0123", "much"),
            "summary.csv: position_settled_rmse_m: found 'much'; allowed: a number",
        ),
        ("a,b\n1,2\n", "summary.csv: found another table; allowed: that of a study"),
        ("", "summary.csv: found another table; allowed: that of a study"),
    ],
)
def test_other_tables_are_refused_in_one_line(say, study, text, says):
    (study / "summary.csv").write_text(text)
    told = say("report", study)
    assert told.code == 2
    (line,) = told.complaints
    assert says in line
    assert not (study / "report.html").exists()


def test_another_page_of_that_name_stays(say, study):
    (study / "report.html").write_text("mine")
    assert say("report", study).code == 2
    assert (study / "report.html").read_text() == "mine"
    assert say("report", study, "--overwrite").code == 0
