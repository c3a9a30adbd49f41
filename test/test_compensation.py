"""Compensation: what each method takes away, from models and from bags, and what is refused."""

import math
import re

import numpy as np
import pytest

from pkm_cnc.array_path import linear, respond
from pkm_cnc.bag import BagWriter, read_run
from pkm_cnc.check import prepare
from pkm_cnc.compensation import METHODS, CompensationOptions, compensate
from pkm_cnc.compensation.correction import CLOSE, SMOOTH, Correction, Span, across
from pkm_cnc.compensation.drive_inverse import drive_inverse
from pkm_cnc.compensation.nominal import nominal
from pkm_cnc.compensation.observation import judged, observe
from pkm_cnc.config import load_setup
from pkm_cnc.contour import circle_program, star_program
from pkm_cnc.errors import InputError
from pkm_cnc.parameters import parameters_of
from pkm_cnc.program import Program
from pkm_cnc.simulation import simulate, simulated_cycles
from pkm_cnc.topics import recorded_topics

TRIPOD = load_setup("tripod")
RESTING = load_setup("tripod", ["motion.wait_in_position=true"])
FASTER = load_setup("tripod", ["drive.kv=23.64"])


def star(feed=6000.0, headings=(75.0,), length=100.0):
    return Program("star.ngc", star_program(feed, headings, (0.0, 0.0), length))


def circle(feed, radius=100.0):
    text = circle_program(
        feed_mm_min=feed,
        radius_mm=radius,
        center_mm=(0.0, 0.0),
        direction="ccw",
        overshoot_deg=90.0,
        acceleration_mm_s2=2000.0,
    )
    return Program("circle.ngc", text)


def largest_um(setup, program):
    """From the step loop alone, by the largest error of a cycle on what is judged."""
    checked = prepare(setup, program)
    errors = (cycle.error for cycle in simulated_cycles(setup, checked))
    return 1e6 * judged(errors, checked.toolpath().contour).largest


def record(folder, setup, program):
    with BagWriter(str(folder), recorded_topics(tuple(setup.axes))) as bag:
        simulate(setup, program, prepare(setup, program), bag)
    return read_run(folder)


def passes_um(result):
    return [1e6 * one.figures.largest for one in result.passes]


# what it must show


def test_a_fast_circle_by_mirror_pass_by_pass():
    result = compensate(TRIPOD, circle(9000.0), options=CompensationOptions(iterations=3, until_um=0.0))
    first, second, third = passes_um(result)
    assert 1e6 * result.before.largest > 250.0
    assert (first < 1.5, second < 0.03, third < 0.002) == (True, True, True)


@pytest.mark.parametrize("setup", [TRIPOD, RESTING], ids=["default", "at rest between"])
@pytest.mark.parametrize("feed", [3000.0, 9000.0])
def test_a_star_by_mirror(setup, feed):
    """What it leaves must be below 0.1 um after one pass and 0.01 after two: it is below that after one."""
    program = star(feed, headings=(30.0,), length=200.0)
    result = compensate(setup, program, options=CompensationOptions(iterations=2, until_um=0.0))
    first, second = passes_um(result)
    assert 1e6 * result.before.largest > 7.0
    assert first < 0.002
    assert second < 0.002


def test_an_arc_between_stops_is_right_all_along():
    """But for the last few mm, where the setpoint rests already."""
    program = Program("arc.ngc", "G21 G90 G17 G61.1\nG0 X50 Y0\nG3 X-50 Y0 I-50 J0 F6000\nM2\n")
    result = compensate(RESTING, program, options=CompensationOptions(iterations=2, until_um=0.0))
    assert 1e6 * result.before.largest > 200.0
    assert result.after.rms < 0.15 * result.before.rms
    assert result.after.largest < 0.6 * result.before.largest


@pytest.mark.parametrize("program", [star(), circle(6000.0, 30.0)], ids=["star", "circle"])
@pytest.mark.parametrize("method", sorted(METHODS))
def test_every_method_and_the_file_does_what_was_predicted(method, program):
    before = largest_um(TRIPOD, program)
    result = compensate(TRIPOD, program, method, options=CompensationOptions(iterations=2))
    after = largest_um(TRIPOD, result.program)
    assert 1e6 * result.before.largest == pytest.approx(before, rel=1e-6)
    assert after == pytest.approx(1e6 * result.after.largest, rel=0.05)
    assert after < 0.03 * before


def test_a_model_that_is_wrong_and_bags_that_are_right(tmp_path):
    wrong = largest_um(FASTER, compensate(TRIPOD, star(), options=CompensationOptions(iterations=1)).program)
    before = largest_um(FASTER, star())
    assert 0.35 < wrong / before < 0.45
    program = star()
    for number in range(2):
        run = record(tmp_path / f"bag{number}", FASTER, program)
        program = compensate(TRIPOD, program, bags=[run], options=CompensationOptions(iterations=1)).program
    assert largest_um(FASTER, program) < 0.03 * before


@pytest.mark.parametrize(("method", "passes"), [("mirror", 3), ("ilc", 5)])
def test_passes_over_bags_do_not_grow(tmp_path, method, passes):
    program, sizes = circle(3000.0, 30.0), []
    for number in range(passes):
        run = record(tmp_path / f"bag{number}", FASTER, program)
        result = compensate(TRIPOD, program, method, bags=[run], options=CompensationOptions(iterations=1))
        program = result.program
        sizes.append(result.passes[-1].correction)
    assert largest_um(FASTER, program) < 0.2
    assert max(sizes) < 1.3 * sizes[0]


def test_what_is_predicted_from_a_bag(tmp_path):
    run = record(tmp_path / "bag", FASTER, star())
    result = compensate(FASTER, star(), bags=[run, run])
    assert largest_um(FASTER, result.program) == pytest.approx(1e6 * result.after.largest, rel=0.1)


def test_a_machine_with_a_coarse_scale_is_run_step_by_step():
    coarse = load_setup("tripod", ["scale.resolution=20e-6"])
    result = compensate(coarse, star(), model=coarse, options=CompensationOptions(iterations=2))
    assert result.after.largest < 0.7 * result.before.largest


def test_damping_takes_its_part():
    result = compensate(TRIPOD, star(), options=CompensationOptions(iterations=1, gain=0.5))
    assert result.after.largest == pytest.approx(0.5 * result.before.largest, rel=0.02)


def test_the_model_knows_what_the_controller_knows():
    imperfect = load_setup("tripod_real")
    known = nominal(imperfect)
    linear(known)
    assert known.actual is known.machine
    changed = {key for key, (value, _) in imperfect.parameters.items() if known.parameters.get(key, ("",))[0] != value}
    assert not {key for key in changed if key.startswith(("geometry", "motion", "limits", "drive.kv", "travel"))}
    assert {"friction.coulomb", "screw.backlash", "actual.tilt.about_x", "u2.screw.stiffness", "scale.noise"} <= changed


def test_what_is_too_tight_or_too_short_is_left_as_it_is():
    """At 6000 mm/min the tool lags by 5 mm: it cuts through an arc of 5 mm, and a line of 8 mm has no middle."""
    text = "G21 G90 G17 F6000\nG1 X90\nG3 X95 Y5 J5\nG1 Y80\nG61.1 X87\nX79\nG61 X0\nM2\n"
    result = compensate(TRIPOD, Program("part.ngc", text), options=CompensationOptions(iterations=2))
    assert result.untouched == (3, 5, 6)
    blocks = [line.split()[1:] for line in result.program.text.splitlines() if line.startswith("N3")]
    assert [block[:1] for block in blocks] == [["G3"]]
    by_line = {element.line: [] for element in result.toolpath.contour}
    for error in observe(TRIPOD, result.program).errors:
        element, start = result.toolpath.contour.elements[error.segment], result.toolpath.contour.starts[error.segment]
        if 0.5 * element.length < error.path_length - start < 0.75 * element.length:
            by_line[element.line].append(1e6 * error.magnitude)
    assert max(by_line[2] + by_line[4] + by_line[7]) < 0.1
    assert max(by_line[3]) > 500.0


def test_corners_that_are_rounded_belong_to_a_curve():
    program = Program("cam.ngc", "G21 G90 G64 P0.05 F3000\nG0 X-50 Y0\nG1 X0 Y0\nX60 Y5\nX120 Y15\nM2\n")
    result = compensate(TRIPOD, program, options=CompensationOptions(iterations=2))
    assert result.after.largest < 0.01 * result.before.largest
    assert largest_um(TRIPOD, result.program) == pytest.approx(1e6 * result.after.largest, rel=0.05)


def test_a_machine_without_contour_errors_is_left_alone():
    line = Program("p", "G1 X350 F3000\nM2\n")
    for method in METHODS:
        assert "the model has no contour error" in refused(load_setup("monopod"), line, method)


# the parts


def span(length=0.1, fade=0.01):
    return Span(0.0, length, round(length / 2e-3), fade, fade)


def test_a_smooth_error_is_found_between_the_ends():
    s = np.linspace(0.0, 0.1, 1500)

    def wanted(s):
        fading = (40.0 * s * (1.0 - 10.0 * s))[:, None] ** 3  # with two derivatives, as what is learnt of stops
        return 1e-4 * fading * np.stack([np.sin(s / 0.02), np.cos(s / 0.015), s / 0.1], axis=1)

    found = Correction.fitted((span(),), s, wanted(s))
    np.testing.assert_allclose(found.at(s), wanted(s), atol=1e-8)
    ends = np.array([0.0, 0.1])
    for derivative in (0, 1, 2):
        np.testing.assert_allclose(found.at(ends, derivative), 0.0, atol=1e-15)
    assert found.at(np.array([-1e-9, 0.1 + 1e-9])).tolist() == [[0.0] * 3] * 2


@pytest.mark.parametrize("weight", [CLOSE, SMOOTH])
def test_a_gap_is_bridged_without_detours(weight):
    s = np.concatenate([np.linspace(0.02, 0.045, 400), np.linspace(0.055, 0.08, 400)])
    found = Correction.fitted((span(),), s, np.full((800, 3), 1e-4), weight)
    assert float(np.abs(found.at(np.linspace(0.0, 0.1, 1000))).max()) < 1.1e-4


def test_runs_are_averaged():
    s = np.linspace(0.0, 0.1, 1500)
    noise = np.random.default_rng(1).normal(0.0, 1e-6, (4, 1500, 3))
    one = Correction.fitted((span(),), s, noise[0])
    four = Correction.fitted((span(),), np.tile(s, 4), noise.reshape(-1, 3))
    middle = np.linspace(0.02, 0.08, 200)
    assert np.std(four.at(middle)) == pytest.approx(0.5 * np.std(one.at(middle)), rel=0.25)


def test_across_is_at_right_angles():
    vectors, tangents = np.array([[1.0, 2.0, 3.0]]), np.array([[0.0, 0.6, 0.8]])
    assert across(vectors, tangents)[0] @ tangents[0] == pytest.approx(0.0, abs=1e-15)


def bump(period, count=3000):
    """From 0 to 0.1 m within a second, as smooth as any filter wants it."""
    t = np.clip((np.arange(count) * period - 0.7) / 1.0, 0.0, 1.0)
    return 0.1 * t**5 * (126.0 + t * (-420.0 + t * (540.0 + t * (-315.0 + t * 70.0))))


@pytest.mark.parametrize("kind", ["cascade", "first_order"])
def test_drives_go_where_the_inverse_sends_them(kind):
    setup = load_setup("tripod", [f"drive.kind={kind}"])
    inverse = drive_inverse(setup)
    wanted = bump(setup.servo_period)
    late = np.interp(np.arange(2900) + inverse.delay, np.arange(3000), wanted)
    plain = respond(setup, "u1", wanted, 0 * wanted, 0 * wanted).position
    for name, filtered, part in (
        ("inverse", inverse.inverse(np.stack([wanted] * 3, axis=1), 20.0), 0.02),
        ("zpetc", inverse.zero_phase(np.stack([wanted] * 3, axis=1)), 1e-3),
    ):
        answered = respond(setup, "u1", filtered[:, 0], 0 * wanted, 0 * wanted).position
        missed = np.interp(np.arange(2900) + inverse.delay, np.arange(3000), answered) - wanted[:2900]
        before = np.interp(np.arange(2900) + inverse.delay, np.arange(3000), plain) - wanted[:2900]
        assert np.abs(missed).max() < part * np.abs(before).max(), name
    assert inverse.delay * setup.servo_period == pytest.approx(1.0 / 20.0, rel=1e-3)
    assert len(late) == 2900


def test_zeros_that_must_not_be_cancelled():
    """A first-order lag sampled exactly has none; three and more integrations sampled have one beyond -1 (Astrom)."""
    assert [len(zeros) for zeros in drive_inverse(load_setup("tripod", ["drive.kind=first_order"])).zeros] == [0] * 3
    for zeros in drive_inverse(TRIPOD).zeros:
        assert all(zero.real < 0.0 or abs(zero) > 1.0 for zero in zeros)


# what is refused


def refused(setup, program, method="mirror", **options):
    with pytest.raises(InputError) as refusal:
        compensate(setup, program, method, **options)
    assert "\n" not in str(refusal.value)
    return str(refusal.value)


def test_bags_that_do_not_fit(tmp_path):
    run = record(tmp_path / "bag", FASTER, star())
    assert "it is of another part program (star.ngc)" in refused(TRIPOD, star(length=99.0), bags=[run])
    other = load_setup("tripod", ["geometry.strut_length=0.61"])
    assert "another machine: geometry.strut_length is 0.6 there and 0.61 here" in refused(other, star(), bags=[run])
    compensated = compensate(TRIPOD, star(), options=CompensationOptions(iterations=1)).program
    assert "it is of the original that this program carries" in refused(TRIPOD, compensated, bags=[run])
    assert "does not look at errors" in refused(TRIPOD, star(), "inverse", bags=[run])
    run.slow["run_end"].clear()
    assert "the run did not complete (it ends early)" in refused(TRIPOD, star(), bags=[run])


def test_a_program_pushed_out_of_the_travel():
    program = circle(9000.0)
    joints = np.array([TRIPOD.machine.inverse(element.position(place)) for element, place in dense(program)])
    most = float(joints[:, 0].max())
    tight = load_setup("tripod", [f"u1.travel.maximum={most + 20e-6!r}"])
    prepare(tight, program)
    reason = refused(tight, program, options=CompensationOptions(iterations=1))
    assert reason.startswith("compensated, circle.ngc:")
    assert "u1 leaves its travel" in reason


def dense(program):
    for element in prepare(TRIPOD, program).toolpath():
        for place in np.linspace(0.0, element.length, 2000):
            yield element, float(place)


def test_a_program_that_would_have_to_slow_down():
    program = circle(9000.0, 40.0)
    toolpath = prepare(TRIPOD, program).toolpath()
    run = observe(TRIPOD, program)
    full = max(range(len(toolpath.elements)), key=lambda index: toolpath.elements[index].length)
    on_it = (run.s > toolpath.starts[full]) & (run.s < toolpath.starts[full + 1])
    fastest = float(np.abs(np.gradient(run.joints, axis=0))[on_it].max()) / TRIPOD.servo_period
    tight = load_setup("tripod", [f"limits.velocity={fastest * 1.0001!r}"])
    reason = refused(tight, program, options=CompensationOptions(iterations=1))
    assert reason.startswith("circle.ngc:")
    assert re.search(r"compensated, the tool would have to slow down by 1\.[5-7]\d* %", reason)


def test_a_model_that_is_unstable_or_another_machine():
    unstable = load_setup("tripod", ["drive.kv=3000"])
    assert "the model cannot run it" in refused(TRIPOD, star(), model=unstable)
    with pytest.raises(InputError, match="the model is unstable"):
        drive_inverse(unstable)
    assert "--model: it is of another machine: machine is bipod" in refused(TRIPOD, star(), model=load_setup("bipod"))


def test_nothing_to_compensate():
    assert "it has rapids alone" in refused(TRIPOD, Program("p", "G0 X10\nM2\n"))
    short = refused(TRIPOD, Program("p", "G61.1 F9000\nG1 X10\nY10\nM2\n"))
    assert "ways between two stops that are too short" in short


def test_options_are_bounded():
    for name, value in (("gain", 0.0), ("iterations", 0), ("until_um", math.nan)):
        spec = next(spec for spec in parameters_of(CompensationOptions) if spec.name == name)
        with pytest.raises(InputError):
            spec.check(value, name)


def test_a_span_holds_samples_at_its_very_ends():
    """Also where begin + intervals * step is rounded to less than its end."""
    rng = np.random.default_rng(1)
    for begin, length in rng.uniform(0.001, 0.4, (200, 2)).tolist():
        span = Span(begin, begin + length, 97, 0.1 * length, 0.1 * length)
        places = np.linspace(span.begin, span.end, 500)
        places[-1] = span.end
        fitted = Correction.fitted((span,), places, np.ones((500, 3)) * 1e-6)
        np.testing.assert_allclose(fitted.at(places[200:300]), 1e-6, rtol=1e-3)
