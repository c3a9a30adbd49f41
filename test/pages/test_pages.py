"""Pages in a real browser: every picture is drawn, the console is silent, nothing is loaded from elsewhere."""

import re
import shutil
import subprocess

import numpy as np
import pytest

from pkm_cnc.config import load_setup
from pkm_cnc.contour import star_program
from pkm_cnc.experiments import Lab, experiment_names, experiment_page, load_experiment, simulated
from pkm_cnc.report import Curve, Figure, Map, Note, Page, Panel, run_page, write_page

FLAGS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --enable-logging=stderr --virtual-time-budget=20000 --dump-dom"
).split()
SMALL = {
    "compensation": {"program": "square", "passes": 1},
    "identification": {"program": "square"},
    "star": {"headings": (0.0, 45.0), "feeds": (6000.0,), "pivot": (0.0, 0.0)},
    "circle": {"radii": (20.0,), "feeds": (3000.0,)},
    "drive-based": {"headings": (0.0, 45.0), "radius": 20.0},
    "kv-mismatch": {"headings": (0.0, 45.0, 180.0, 225.0), "length": 100.0, "radius": 20.0, "periods": (4.0, 2.0)},
    "workspace-map": {"points": 3, "headings": (0.0, 45.0, 90.0), "jobs": 1},
}
"""Options that make the longer experiments short."""


@pytest.fixture
def browse(tmp_path):
    """Loads a page; returns its DOM after everything has been drawn, and what the console said."""
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    assert program, "no chromium found: make test-pages needs it (Debian: apt-get install chromium)"

    def load(path):
        command = [program, *FLAGS, f"--user-data-dir={tmp_path / 'browser'}", f"file://{path}"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
        return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line]

    return load


def drawn(dom):
    """Figures with the number of traces that the browser drew of each: lines and points, maps."""
    found = {}
    for part in re.split(r'<div id="figure-', dom)[1:]:
        name = part.partition('"')[0]
        picture = part.partition("<figcaption>")[0]
        found[name] = len(re.findall(r'class="trace scatter', picture)) + len(re.findall(r'class="hm"', picture))
    return found


def check(browse, folder, page):
    dom, console = browse(write_page(folder, page)[-1])
    assert console == []
    traces = {
        figure.name: sum(len(panel.curves) + (panel.map is not None) for panel in figure.panels)
        for figure in page.figures
    }
    assert drawn(dom) == traces
    return dom


X = np.linspace(0.0, 1.0, 20)
GRID = Map(X[:5], X[:4], np.arange(20.0).reshape(4, 5), "value (um)")


def page_of(*panels):
    return Page("a page", "a question", "a command", [], [Figure("figure", "a figure", panels)])


def test_every_kind_of_panel(browse, tmp_path):
    curves = [Curve("a", X, X * X), Curve("b", X, X, kind="points"), Curve("c", X, -X, role="programmed")]
    others = [
        Curve("a", X, X, kind="line and points", bars=0.1 * X),
        Curve("", np.array([0.0, 1.0, 1.0]), np.array([0.0, 0.0, 1.0]), kind="area"),
        Curve("d", X, -X, arrow=True, like="a", value=X, value_label="dR (um)"),
        Curve("e", X, 0.0 * X, role="aside"),
        Curve("f", X, 0.5 + 0.0 * X, role="scale"),
    ]
    check(
        browse,
        tmp_path / "page",
        page_of(
            Panel("lines", "x (mm)", "y (um)", curves),
            Panel("plan", "x (mm)", "y (mm)", curves, equal=True),
            Panel("map", "x (mm)", "y (mm)", curves[:1], map=GRID),
            Panel("others", "x (mm)", "y (mm)", others, rows=2, x_range=(0.0, 2.0), y_range=(-1.0, 1.0)),
        ),
    )


def test_panels_that_share_their_x_are_zoomed_together(browse, tmp_path):
    panels = [Panel(name, "x", "y", [Curve(name, X, X)]) for name in "abc"]
    page = Page("a", "b", "c", [], [Figure("together", "", panels[:2], share_x=True), Figure("alone", "", panels[:2])])
    path = write_page(tmp_path / "page", page)[-1]
    zoom = """<script>["together", "alone"].forEach(name => {
        Plotly.relayout("figure-" + name + "-1", {"xaxis.range": [0.25, 0.5]}).then(() => setTimeout(() => {
            const other = document.getElementById("figure-" + name + "-2");
            document.body.append(name + ":" + other.layout.xaxis.range + ";");
        }, 1000));
    });</script></body>"""
    path.write_text(path.read_text(encoding="utf-8").replace("</body>", zoom), encoding="utf-8")
    dom, console = browse(path)
    assert console == []
    assert "together:0.25,0.5;" in dom
    assert re.search(r"alone:(?!0.25)[^;]+;", dom)


def test_texts_stay_texts(browse, tmp_path):
    text = '<img src=x onerror="alert(1)"> </script> %{x} "a" & $b$ \\u0000'
    curves = [Curve(text, X, X, value=X, value_label=text), Curve("", X, X, kind="points")]
    panels = [
        Panel(text, text, text, curves, notes=[Note(0.5, 0.5, text)]),
        Panel(text, text, text, map=Map(X[:5], X[:4], np.arange(20.0).reshape(4, 5), text)),
    ]
    dom = check(browse, tmp_path / "page", Page(text, text, text, [], [Figure("figure", text, panels, text)], [text]))
    assert re.findall(r"<img (\w+)", dom.partition("<body>")[2]) == ["class"]  # the page's own, for paper


def test_what_is_broken_is_found(browse, tmp_path):
    path = write_page(tmp_path / "page", page_of(Panel("lines", "x", "y", [Curve("a", X, X)])))[-1]
    whole = path.read_text(encoding="utf-8")
    path.write_text(whole.replace("Plotly.newPlot(", "Plotly.noSuchThing("), encoding="utf-8")
    dom, console = browse(path)
    assert console
    assert drawn(dom) == {"figure": 0}
    path.write_text(whole.replace("<h1>", '<img src="https://example.org/a.png"><h1>'), encoding="utf-8")
    assert any("Content Security Policy" in line for line in browse(path)[1])


def test_page_of_a_run(browse, tmp_path):
    lab = Lab("tripod", (), simulated)
    trial = lab.run(lab.setup(), star_program(6000, [0, 60], (0, 0), 60), "<star> & co.ngc")
    dom = check(browse, tmp_path / "page", run_page(trial.evaluation, load_setup("tripod"), "pkm_cnc evaluate"))
    assert "&lt;star&gt; &amp; co.ngc on tripod" in dom


@pytest.mark.parametrize("name", experiment_names())
def test_page_of_an_experiment(browse, tmp_path, name):
    experiment = load_experiment(name)
    lab, options = Lab(experiment.machine, (), simulated), experiment.options(**SMALL.get(name, {}))
    page = experiment_page(experiment, lab, options, experiment.run(lab, options), f"pkm_cnc experiment {name}")
    assert page.figures
    check(browse, tmp_path / "page", page)
