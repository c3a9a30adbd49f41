"""Tables and pictures: from runs of the simulation, looked at from outside (files, texts in them, pixels)."""

import itertools
import math
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import matplotlib
import matplotlib.image
import numpy as np
import pytest

from pkm_cnc.check import prepare
from pkm_cnc.config import load_setup
from pkm_cnc.contour import ContourMonitor, circle_program, star_program
from pkm_cnc.errors import InputError
from pkm_cnc.evaluation import Evaluation
from pkm_cnc.program import Program
from pkm_cnc.report import (
    Curve,
    Figure,
    Map,
    Note,
    Page,
    Panel,
    Table,
    round_scale,
    run_page,
    run_remarks,
    run_tables,
    text_table,
    write_page,
)
from pkm_cnc.report.judged import judged_cycles
from pkm_cnc.report.thinning import MOST_POINTS, thinned
from pkm_cnc.simulation import simulated_cycles

SETUP = load_setup("tripod", ["drive.kind=first_order"])
PICTURES = (".svg", ".png")
SVG = "{http://www.w3.org/2000/svg}"


def draw(evaluation, folder):
    """The files of a run's report that are pictures."""
    return [path for path in write_page(folder, run_page(evaluation, SETUP, "made by hand")) if path.suffix in PICTURES]


def table(evaluation):
    return "\n\n".join([*map(text_table, run_tables(evaluation)), *run_remarks(evaluation)])


def evaluated(text, cycles=None):
    """The evaluation of a simulated program, of its first `cycles` alone if that is given."""
    program = Program(name="test.ngc", text=text)
    checked = prepare(SETUP, program)
    toolpath = checked.toolpath()
    monitor, errors, true = ContourMonitor(), [], []
    for cycle in simulated_cycles(SETUP, checked):
        if cycle.cycle == cycles:
            break
        for segment in cycle.entered:
            monitor.add_segment(*segment)
        point = (cycle.tcp.x, cycle.tcp.y, cycle.tcp.z)
        errors.append(monitor.step(cycle.setpoint, point, point)[1])
        true.append(point)
    return Evaluation(
        machine="tripod",
        servo_period=SETUP.servo_period,
        program_name=program.name,
        end=None,
        elements=list(toolpath.elements),
        starts=list(toolpath.starts),
        summaries={summary.segment: summary for summary in monitor.finish()},
        errors=errors,
        true=np.array(true),
    )


@pytest.fixture(scope="module")
def star():
    return evaluated(star_program(6000, [0, 45, 90, 180], (0, 0), 60))


@pytest.fixture(scope="module")
def circle():
    return evaluated(circle_text(15, "both"))


def circle_text(radius, direction):
    return circle_program(
        feed_mm_min=3000,
        radius_mm=radius,
        center_mm=(0, 0),
        direction=direction,
        overshoot_deg=40,
        acceleration_mm_s2=2000,
    )


@pytest.fixture(scope="module")
def star_pictures(star, tmp_path_factory):
    return draw(star, tmp_path_factory.mktemp("star") / "new" / "folder")


@pytest.fixture(scope="module")
def circle_pictures(circle, tmp_path_factory):
    return draw(circle, tmp_path_factory.mktemp("circle"))


def names(paths):
    return [path.name for path in paths]


def texts(path):
    """All text in an SVG file."""
    root = ElementTree.parse(path).getroot()
    assert root.tag == f"{SVG}svg"
    return "\n".join("".join(element.itertext()) for element in root.iter(f"{SVG}text"))


def check_files(paths):
    for path in paths:
        if path.suffix == ".png":
            pixels = matplotlib.image.imread(path)
            assert min(pixels.shape[:2]) > 400
            assert pixels.std() > 0.01  # something is drawn
        else:
            assert "1e+" not in texts(path)


def test_star(star, star_pictures):
    paths = star_pictures
    assert names(paths) == ["star.svg", "star.png", "contour_error.svg", "contour_error.png"]
    check_files(paths)
    text = texts(paths[0])
    for label in ("x (mm)", "y (mm)", "left (um)", "z (um)", "heading (deg", "6000 mm/min", "45°", "90°", "180°"):
        assert label in text
    # The largest error may be drawn over a tenth of the line's length.
    largest = max(entry["contour_error_um"]["max_abs"] for entry in star.segments())
    scale = float(re.search(r"magnified ([\d.]+):1", text).group(1))
    assert 60e3 * 0.1 / 2.5 <= scale * largest <= 60e3 * 0.1
    assert f"{scale:.0e}"[0] in "125"


def test_circle(circle, circle_pictures):
    paths = circle_pictures
    assert names(paths) == ["circle.svg", "circle.png", "contour_error.svg", "contour_error.png"]
    check_files(paths)
    text = texts(paths[0])
    for label in (
        "x (mm)",
        "y (mm)",
        "dR (um)",
        "(deg)",
        "counter-clockwise",
        "clockwise",
        "R 15.000 mm",
        "3000 mm/min",
    ):
        assert label in text
    maxima = [entry["extrema_deg"] for entry in circle.segments() if entry["kind"] == "circle"]
    assert len(maxima) == 2
    for angle in (angle for angles in maxima for angle in angles):
        assert f"{angle:.2f}" in text


def test_several_stars_and_circles_are_numbered(tmp_path):
    lines = "G0 X-10 Y{y}\nG1 X10 F3000\nG0 X0 Y{a}\nG1 Y{b}\n"
    stars = "".join(lines.format(y=y, a=y - 10, b=y + 10) for y in (0, 30))
    circles = "".join(circle_text(radius, "ccw").replace("M2\n", "") for radius in (10, 15))
    paths = draw(evaluated(f"G21 G90 G17\n{stars}{circles}M2\n"), tmp_path)
    assert names(paths)[::2] == ["star-1.svg", "star-2.svg", "circle-1.svg", "circle-2.svg", "contour_error.svg"]
    check_files(paths)


def test_single_line_has_its_error_along_the_path(tmp_path):
    paths = draw(evaluated("G21 G90\nG1 X20 F3000\nM2\n"), tmp_path)
    assert names(paths) == ["contour_error.svg", "contour_error.png"]
    check_files(paths)
    text = texts(paths[0])
    for label in ("left (um)", "up (um)", "3-D (um)", "(mm)"):
        assert label in text


def test_vertical_line_has_no_sides(tmp_path):
    evaluation = evaluated("G21 G90\nG1 Z-20 F3000\nM2\n")
    paths = draw(evaluation, tmp_path)
    check_files(paths)
    assert texts(paths[0]).count("the path is vertical") == 2
    row = next(line for line in table(evaluation).splitlines() if line.lstrip().startswith("2 "))
    assert row.split()[1] == "-"  # no heading


def test_unfinished_runs(star, tmp_path):
    text = star_program(6000, [0, 90], (0, 0), 60)
    for cycles, judged in ((1, 0), (600, 1)):
        evaluation = evaluated(text, cycles)
        paths = draw(evaluation, tmp_path / str(cycles))
        assert names(paths) == ["contour_error.svg", "contour_error.png"]
        check_files(paths)
        assert len(evaluation.segments()) == judged
        assert run_page(evaluation, SETUP, "").question.endswith(f"tripod: {cycles} cycles, {cycles / 1000:.3f} s.")
    assert "no evaluated segment was run" in table(evaluated(text, 1))


def contents(paths):
    return {path.name: path.read_bytes() for path in paths}


def test_equal_runs_give_equal_files(star, star_pictures, tmp_path):
    assert contents(draw(star, tmp_path)) == contents(star_pictures)


def test_pictures_do_not_follow_the_readers_settings(circle, circle_pictures, tmp_path):
    settings = {"font.size": 20.0, "lines.linewidth": 5.0, "svg.fonttype": "path"}
    with matplotlib.rc_context(settings):
        assert contents(draw(circle, tmp_path)) == contents(circle_pictures)
        assert all(matplotlib.rcParams[name] == value for name, value in settings.items())


def test_refuses_what_cannot_be_written(circle, tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match=r"report .*file: File exists"):
        draw(circle, tmp_path / "file")


def test_machine_without_error(star, tmp_path):
    """A star whose contour errors are all zero, as on a Cartesian machine."""
    zero = [error._replace(x=0.0, y=0.0, z=0.0, left=0.0, up=0.0, magnitude=0.0) for error in star.errors]
    nothing = {f"{part}_{name}": 0.0 for part in ("left", "up") for name in ("mean", "std", "rms", "max_abs")}
    summaries = {index: summary._replace(**nothing) for index, summary in star.summaries.items()}
    paths = draw(replace(star, errors=zero, summaries=summaries), tmp_path)
    check_files(paths)
    assert "1000000:1" in texts(paths[0])


def test_judged_cycles_are_those_of_the_summaries(star, circle):
    for evaluation in (star, circle):
        judged = judged_cycles(evaluation)
        for index, summary in evaluation.summaries.items():
            mine = [error.segment == index and judged[row] for row, error in enumerate(evaluation.errors)]
            assert sum(mine) == summary.cycles > 0


@pytest.mark.parametrize(
    ("largest", "room", "scale"),
    [
        (10e-6, 0.02, 2000),
        (10.01e-6, 0.02, 1000),
        (1e-3, 0.02, 20),
        (0.1, 0.02, 0.2),
        (0.0, 0.02, 1e6),
        (5e-6, 0.025, 5000),
    ],
)
def test_round_scale(largest, room, scale):
    assert round_scale(largest, room) == pytest.approx(scale, rel=1e-12)


def test_table_is_aligned_and_carries_units(star, circle):
    for evaluation, kind in ((star, "Lines"), (circle, "Circles")):
        block = next(part for part in table(evaluation).split("\n\n") if part.startswith(kind)).splitlines()
        header, rule, rows = block[1], block[2], block[3:]
        assert set(rule) == {"-"}
        ends = [match.end() for match in re.finditer(r"\S+", header)]
        for row in rows:
            assert len(row) == len(header)
            for end in ends[1:] if kind == "Circles" else ends:  # directions are words
                assert row[end - 1] != " "
                assert row[end : end + 1] in ("", " ")
        for name in header.split():
            assert name in ("line", "direction", "below_feed") or re.search(r"_(deg|mm|um|mm_min)$", name)
    assert len(rows) == 2


def test_table_has_the_figures(star):
    row = next(line for line in table(star).splitlines() if " 90.0 " in line).split()
    entry = next(entry for entry in star.segments() if math.isclose(entry["heading_deg"], 90.0))
    assert float(row[3]) == pytest.approx(entry["contour_error_um"]["mean"], abs=5e-4)
    assert row[3].startswith("+")  # left of travel
    assert float(row[6]) == pytest.approx(entry["contour_error_z_um"]["mean"], abs=5e-4)


HOSTILE = "</script><script>alert(1)</script> \"a\" 'b' & <b>ü\N{SNOWMAN}</b> $title ${question}"


def every_kind(text="plain"):
    """A page with every kind of panel; `text` stands wherever a text may stand."""
    x = np.linspace(0.0, 1.0, 50)
    curves = [Curve(text, x, x * x), Curve("", x, x, kind="points"), Curve("p", x, -x, role="programmed")]
    curves.append(Curve("gap", x, np.where(x > 0.5, x, np.nan), kind="line and points", bars=0.1 * x))
    curves.append(Curve("", np.array([0.0, 1.0, 1.0]), np.array([0.0, 0.0, 1.0]), kind="area"))
    curves.append(Curve("arrow", x, 0.5 * x, arrow=True, like=text, value=x, value_label=text))
    field = Map(x[:5], x[:4], np.where(np.arange(20).reshape(4, 5) == 7, np.nan, np.arange(20.0).reshape(4, 5)), text)
    panels = [
        Panel(text, text, text, curves, notes=[Note(0.5, 0.5, text)], x_step=0.25),
        Panel(text, "x (mm)", "y (mm)", curves, equal=True),
        Panel(text, "x (mm)", "y (mm)", map=field),
    ]
    figures = [Figure("first", text, panels, text, columns=2), Figure("second", text, panels[:2], share_x=True)]
    table = Table(text, ("name", "value_um"), [(text, 1.0 / 3.0), ("none", None)])
    return Page(text, text, text, [table], figures, [text], [table], [(text, "a/b.html")], {"a": 1})


def test_page_says_what_it_was_given(tmp_path):
    paths = write_page(tmp_path, every_kind())
    assert names(paths) == ["first.svg", "first.png", "second.svg", "second.png", "data.json", "index.html"]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(names(paths))  # no temporary file is left
    page = paths[-1].read_text(encoding="utf-8")
    for part in (
        "<title>plain</title>",
        "0.333333",
        ">-<",
        'href="a/b.html"',
        'id="figure-first"',
        "<code>plain</code>",
    ):
        assert part in page
    assert page.count("plotly.js v") == 1  # the script is there once
    assert contents(write_page(tmp_path / "again", every_kind())) == contents(paths)


def test_page_takes_texts_as_texts(tmp_path):
    page = write_page(tmp_path, every_kind(HOSTILE))[-1].read_text(encoding="utf-8")
    body = page[page.index("<body>") :]
    assert "<script>alert" not in page
    assert "<b>ü" not in body
    assert "&lt;b&gt;ü\N{SNOWMAN}&lt;/b&gt; $title ${question}" in body


@pytest.mark.filterwarnings("error")
def test_any_file_name_can_be_drawn(tmp_path):
    """Mathematics, control characters, bytes that are no UTF-8, letters that the font lacks."""
    text = "$x$ $\\frac a\0b\x1b[31m \udcff \N{CJK UNIFIED IDEOGRAPH-4E2D} ]]>"
    paths = write_page(tmp_path, every_kind(text))
    for path in paths:
        if path.suffix == ".svg":
            shown = text.translate({0: "\ufffd", 0x1B: "\ufffd", 0xDCFF: "\ufffd"})
            assert texts(path).count(shown) >= 4
    paths[-1].read_text(encoding="utf-8")


def test_pictures_of_a_page_are_sent_to_nobody(tmp_path):
    page = write_page(tmp_path, every_kind())[-1].read_text(encoding="utf-8")
    assert 'showSendToCloud: false, plotlyServerURL: ""' in page


def test_page_loads_nothing(tmp_path):
    page = write_page(tmp_path, every_kind())[-1].read_text(encoding="utf-8")
    assert "default-src 'none'" in page
    without_script = re.sub(r"<script\b.*?</script>", "", page, flags=re.S)
    assert set(re.findall(r"(?:src|href)=\"([a-z]+:)", without_script)) == {"data:"}


def long_figure(x, y, **kind):
    return Figure("long", "", [Panel("", "", "", [Curve("a", x, y, **kind)])], "What there is.")


def test_long_curves_keep_ends_gaps_and_extremes():
    x = np.linspace(0.0, 1.0, 100_001)
    y = np.sin(50.0 * x)
    y[12_345], y[77_777], y[50_000:50_003], y[50_010] = 5.0, -6.0, np.nan, np.nan
    thin = thinned(long_figure(x, y, value=2.0 * y, bars=3.0 * y))
    curve = thin.panels[0].curves[0]
    assert len(curve.x) <= MOST_POINTS + 2
    assert (curve.x[0], curve.x[-1]) == (0.0, 1.0)
    assert np.nanmax(curve.y) == 5.0
    assert np.nanmin(curve.y) == -6.0
    assert np.flatnonzero(np.isnan(curve.y)).size == 2  # two gaps, though so near that one stretch has both
    assert (np.diff(curve.x) > 0.0).all()
    np.testing.assert_array_equal(curve.value, 2.0 * curve.y)
    np.testing.assert_array_equal(curve.bars, 3.0 * curve.y)
    assert str(MOST_POINTS) in thin.caption  # the reader is told
    # Between the points that are left the curve is where it was: 60 points of it bend by (50 * 6e-4)^2 / 8.
    still = np.interp(x, *(values[np.isfinite(curve.y)] for values in (curve.x, curve.y)))
    near = [np.abs(np.arange(len(x)) - at) < 100 for at in (12_345, 77_777, 50_005)]
    assert np.abs(still - y)[~np.any(near, axis=0)].max() < 1.2e-4


def test_short_curves_and_areas_stay_as_they_are():
    x = np.linspace(0.0, 1.0, MOST_POINTS)
    for figure in (long_figure(x, x), long_figure(np.tile(x, 3), np.tile(x, 3), kind="area")):
        assert thinned(figure) is figure


def test_panels_take_the_first_free_place():
    def places(*rows, columns):
        panels = [Panel("", "", "", rows=taken) for taken in rows]
        return Figure("", "", panels, columns=columns).places()

    assert places(1, 1, 1, columns=1) == [(0, 0), (1, 0), (2, 0)]
    assert places(1, 1, 1, columns=2) == [(0, 0), (0, 1), (1, 0)]
    assert places(2, 1, 1, 1, columns=2) == [(0, 0), (0, 1), (1, 1), (2, 0)]
    assert places(1, 2, 1, 1, columns=2) == [(0, 0), (0, 1), (1, 0), (2, 0)]


def test_a_name_has_one_look_in_the_whole_figure():
    from pkm_cnc.report.looks import DATA, PROGRAMMED, looks

    x = np.zeros(1)
    first = Panel(
        "", "", "", [Curve("a", x, x), Curve("b", x, x), Curve("", x, x), Curve("p", x, x, role="programmed")]
    )
    second = Panel("", "", "", [Curve("b", x, x), Curve("c", x, x)])
    assert looks(Figure("f", "", [first, second])) == [[DATA[0], DATA[1], DATA[1], PROGRAMMED], [DATA[1], DATA[2]]]
    like = Panel("", "", "", [Curve("d", x, x, like="a"), Curve("", x, x, kind="points"), Curve("e", x, x)])
    assert looks(Figure("f", "", [first, like]))[1] == [DATA[0], DATA[0], DATA[2]]


def test_looks_differ_in_grey():
    """Neighbours in the order of use are told apart without colour: by tone, by dashes or by marker."""
    from pkm_cnc.report.looks import DATA

    def tone(look):
        red, green, blue = (int(look.color[at : at + 2], 16) for at in (1, 3, 5))
        return 0.2126 * red + 0.7152 * green + 0.0722 * blue

    assert len({(look.dashes, look.marker) for look in DATA}) == len(DATA)
    for one, other in itertools.pairwise(DATA):
        assert abs(tone(one) - tone(other)) > 20.0


def test_numbers_of_a_column_are_written_alike():
    rows = [
        ("a", 9.694637123, 1, 2.5e-16, None, 1e12),
        ("b", -1.0958e-07, 20, 1e-17, 0.5, 2.0),
        ("c", 0.25, 3, 0.0, 3.0, 1.5),
    ]
    texts = text_table(Table("t", ("name", "x_um", "n", "noise_m", "half", "large"), rows)).splitlines()[3:]
    assert [line.split() for line in texts] == [
        ["a", "9.69464", "1", "2.5e-16", "-", "1e+12"],
        ["b", "0.00000", "20", "1e-17", "0.5", "2"],
        ["c", "0.25000", "3", "0", "3.0", "1.5"],
    ]
