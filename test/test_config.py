"""Machine files: what they say is what runs, and what they get wrong is named with key, value and bound."""

import dataclasses
import math

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from pkm_cnc.config import load_setup, machine_files, setup_from_parameters, setup_from_text
from pkm_cnc.errors import InputError
from pkm_cnc.parameters import parameter, read_section

TRIPOD = machine_files()["tripod"].read_text(encoding="utf-8")


def file_of(parameters):
    return yaml.safe_dump({"/**": {"ros__parameters": parameters}})


def refused(parameters, message):
    with pytest.raises(InputError, match=message) as error:
        setup_from_text(file_of({"machine": "tripod", **parameters}))
    assert "\n" not in str(error.value)


def test_the_tripod_is_that_of_the_thesis():
    setup = load_setup("tripod")
    assert setup.machine_name == "tripod"
    assert list(setup.axes) == ["u1", "u2", "u3"]
    assert setup.servo_period_ns == 1_000_000
    geometry = {key: value for key, (value, _) in setup.parameters.items() if key.startswith("geometry.")}
    assert geometry["geometry.base_radius"] == 0.513
    assert geometry["geometry.platform_radius"] == 0.150
    assert geometry["geometry.strut_length"] == 0.600
    assert [math.degrees(angle) for angle in geometry["geometry.azimuth"]] == pytest.approx([45, 165, 285])
    assert {parts.drive.kv for parts in setup.axes.values()} == {20.0}
    assert {parts.screw.pitch for parts in setup.axes.values()} == {0.010}


def test_the_file_of_the_tripod_says_what_the_defaults_say():
    """So nobody has to know both."""
    bare = setup_from_text(file_of({"machine": "tripod"}))
    assert bare.parameters == load_setup("tripod").parameters


def test_a_jerk_that_takes_ages_to_reach_the_acceleration_is_refused():
    refused({"motion.jerk": 0.19}, r"motion.jerk: 0.19 m/s\^3 takes more than 10 s .* at least 0.2 m/s\^3")
    refused({"u2.limits.jerk": 1e-9}, r"u2.limits.jerk: 1e-09 .* at least 4 m/s\^3")
    setup_from_text(file_of({"machine": "tripod", "motion.jerk": 0.2, "limits.jerk": 4.0}))


def test_every_parameter_has_a_meaning_and_every_number_a_bound():
    """But the ends of a drive's travel, which bound each other."""
    for key, (value, spec) in load_setup("tripod").parameters.items():
        assert spec.doc, key
        if type(value) in (int, float) and not key.startswith("travel."):
            assert any(bound is not None for bound in (spec.above, spec.minimum, spec.maximum)), key


@settings(derandomize=True, max_examples=40, deadline=None)
@given(
    kv=st.floats(0.5, 100.0),
    own=st.floats(0.5, 100.0),
    start=st.tuples(*[st.floats(-0.1, 0.1)] * 3),
    window=st.integers(1, 1000),
    period=st.integers(10_000, 100_000_000),
)
def test_what_is_written_out_in_full_makes_the_same_setup_again(kv, own, start, window, period):
    setup = setup_from_parameters(
        {
            "machine": "tripod",
            "drive.kv": kv,
            "u2.drive.kv": own,
            "start_pose": start,
            "graph.window": window,
            "servo_period": period / 1e9,
        }
    )
    again = setup_from_text(setup.to_yaml())
    assert again.parameters == setup.parameters
    assert again.axes == setup.axes
    assert again.servo_period_ns == period
    assert [parts.drive.kv for parts in again.axes.values()] == [kv, own, kv]
    assert again.to_yaml() == setup.to_yaml()


def test_overrides_come_after_the_file_and_one_axis_after_all():
    setup = load_setup("tripod", ["drive.kv=25", "u2.drive.kv=30", "start_pose=[0.01, 0, -0.02]", "graph.window=1"])
    assert [parts.drive.kv for parts in setup.axes.values()] == [25.0, 30.0, 25.0]
    assert setup.start_pose == (0.01, 0.0, -0.02)
    assert setup.graph.window == 1
    assert setup.axes["u2"].drive == dataclasses.replace(setup.axes["u1"].drive, kv=30.0)


@pytest.mark.parametrize("text", ["1e-5", "1.0e-5", "0.00001"])
def test_every_way_to_write_a_small_number_is_read(text):
    assert load_setup("tripod", [f"scale.resolution={text}"]).axes["u1"].scale.resolution == 1e-5
    assert load_setup("tripod", [f"start_pose=[{text}, 0, 0.0]"]).start_pose == (1e-5, 0.0, 0.0)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"drive": {"kvv": 20.0}}, r"^drive\.kvv: unknown parameter; .*kv"),
        ({"u3": {"drive": {"kvv": 20.0}}}, r"^u3\.drive\.kvv: unknown parameter"),
        ({"u4": {"drive": {"kv": 20.0}}}, r"^u4\.drive\.kv: unknown parameter; sections are .*u3\.drive"),
        ({"drives": {"kv": 20.0}}, r"^drives\.kv: unknown parameter; sections are actual\.geometry, .*, drive, "),
        ({"servoperiod": 0.001}, r"^servoperiod: unknown parameter; .*servo_period"),
        ({"u1": {"geometry": {"strut_length": 0.6}}}, r"^u1\.geometry\.strut_length: unknown parameter"),
        ({"drive": 20.0}, r"^drive: unknown parameter"),
        ({1: 2}, r"^1: unknown parameter"),
    ],
)
def test_an_unknown_key_is_named_with_what_there_is(parameters, message):
    refused(parameters, message)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"drive": {"kv": "fast"}}, r"^drive\.kv: 'fast' is not a number$"),
        ({"drive": {"kv": True}}, r"^drive\.kv: True is not a number$"),
        ({"drive": {"kv": None}}, r"^drive\.kv: None is not a number$"),
        ({"drive": {"kv": [20.0]}}, r"^drive\.kv: \[20\.0\] is not a number$"),
        ({"drive": {"kind": 1}}, r"^drive\.kind: 1 is not a text$"),
        ({"graph": {"window": 8.0}}, r"^graph\.window: 8\.0 is not a whole number$"),
        ({"start_pose": 0.0}, r"^start_pose: 0\.0 is not a list of numbers$"),
        ({"start_pose": [0.0, 0.0]}, r"^start_pose: 2 numbers given, 3 wanted$"),
        ({"start_pose": [0.0, "a", 0.0]}, r"^start_pose\[1\]: 'a' is not a number$"),
        ({"drive": {"kv": 10**400}}, r"^drive\.kv: 10+ is not a number$"),
        ({"start_pose": [0.0, 0.0, 10**400]}, r"^start_pose\[2\]: 10+ is not a number$"),
        ({"graph": {"window": 10**400}}, r"^graph\.window: 10+ cycles is over its maximum 1000 cycles$"),
        ({"machine": 3}, r"^machine: "),
    ],
)
def test_a_wrong_type_is_named(parameters, message):
    refused(parameters, message)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"servo_period": 1.0}, r"^servo_period: 1\.0 s is over its maximum 0\.1 s$"),
        ({"servo_period": 1e-6}, r"^servo_period: 1e-06 s is below its minimum 1e-05 s$"),
        ({"servo_period": 0.0010000001}, r"^servo_period: 0\.0010000001 s is not a whole number of nanoseconds$"),
        ({"drive": {"kv": -20.0}}, r"^drive\.kv: -20\.0 1/s is "),
        ({"drive": {"kv": math.nan}}, r"^drive\.kv: nan is not a finite number$"),
        ({"drive": {"kv": math.inf}}, r"^drive\.kv: inf is not a finite number$"),
        ({"drive": {"kind": "stepper"}}, r"^drive\.kind: 'stepper' is not one of cascade, "),
        ({"graph": {"window": 0}}, r"^graph\.window: 0 cycles is below its minimum 1 cycles$"),
        ({"start_pose": [0.0, 0.0, -101.0]}, r"^start_pose\[2\]: -101\.0 m is below its minimum -100\.0 m$"),
        ({"u3": {"drive": {"kv": -1.0}}}, r"^u3\.drive\.kv: -1\.0 1/s is "),
        ({"travel": {"minimum": 1.5}}, r"^travel\.minimum: 1\.5 m is not below the maximum of 1\.0 m$"),
        ({"u3": {"travel": {"minimum": 1.5}}}, r"^u3\.travel\.minimum: 1\.5 m is not below the maximum of 1\.0 m$"),
        ({"u2": {"drive": {"position_integral_time": 1e-9}}}, r"^u2\.drive\.position_integral_time: 1e-09 is below"),
        ({"machine": "octopod"}, r"octopod"),
    ],
)
def test_a_value_out_of_range_is_named_with_its_bound(parameters, message):
    refused(parameters, message)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"top level"),
        ("machine: tripod", r"top level must be '/\*\*:'"),
        ("/**:", r"top level|ros__parameters"),
        ("/**:\n  parameters: {machine: tripod}", r"ros__parameters"),
        ("/**:\n  ros__parameters:\n", r"ros__parameters"),
        ("/**:\n  ros__parameters: {}\n", r"^machine: nothing given"),
        ("/**:\n ros__parameters: {machine: tripod, drive: {kv: 1, kv: 2}}", r"kv is given twice .*line 2"),
        ("/**:\n ros__parameters: {a: [1\n", r"not valid YAML: .*line"),
        ("/**:\n ros__parameters: {a: 2020-13-45}\n", r"not valid YAML: month"),
        ("- 1\n- 2\n", r"top level"),
    ],
)
def test_a_file_of_another_form_is_refused(text, message):
    with pytest.raises(InputError, match=message) as error:
        setup_from_text(text)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("drive.kv", r"--set drive\.kv: must be KEY=VALUE"),
        ("=3", r"--set =3: must be KEY=VALUE"),
        ("drive.kv=[1", r"--set drive\.kv=\[1: '\[1' is not a value"),
        ("drive.kv=2020-13-45", r"--set drive\.kv=2020-13-45: '2020-13-45' is not a value"),
        ("drive.kv=", r"drive\.kv: None is not a number"),
        ("drive.kw=3", r"drive\.kw: unknown parameter"),
    ],
)
def test_an_override_that_cannot_be_used_is_named(override, message):
    with pytest.raises(InputError, match=message):
        load_setup("tripod", [override])


def test_a_file_that_is_not_there_is_named_with_those_that_are():
    with pytest.raises(InputError, match=r"^machine octopod: No such file or directory; by name there are: .*tripod"):
        load_setup("octopod")


def test_the_file_is_named_before_its_error(tmp_path):
    (tmp_path / "mine.yaml").write_text(TRIPOD.replace("kv: 20.0", "kv: -20.0"))
    with pytest.raises(InputError, match=r"^machine .*mine\.yaml: drive\.kv: -20\.0 1/s"):
        load_setup(str(tmp_path / "mine.yaml"))


def test_a_file_that_is_no_text_is_refused(tmp_path):
    (tmp_path / "mine.yaml").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(InputError, match=r"not a text file"):
        load_setup(str(tmp_path / "mine.yaml"))


def test_the_actual_machine_is_the_nominal_one_unless_the_file_says_otherwise():
    setup = load_setup("tripod")
    assert setup.actual is setup.machine
    other = load_setup("tripod", ["actual.geometry.strut_length=0.6003"])
    assert other.machine.inverse((0.0, 0.0, 0.0))[0] == setup.machine.inverse((0.0, 0.0, 0.0))[0]
    expected = load_setup("tripod", ["geometry.strut_length=0.6003"]).machine
    joints = setup.machine.inverse((0.01, 0.02, 0.03))
    np.testing.assert_array_equal(other.actual.forward(joints), expected.forward(joints))
    again = setup_from_text(other.to_yaml())
    np.testing.assert_array_equal(again.actual.forward(joints), expected.forward(joints))


def test_what_cannot_be_built_is_named_as_actual():
    with pytest.raises(InputError, match=r"^actual\.geometry\.strut_length: 0\.1 m is not above"):
        setup_from_parameters({"machine": "tripod", "actual.geometry.strut_length": 0.1})
    with pytest.raises(InputError, match=r"^actual\.geometry\.strut: unknown parameter"):
        setup_from_parameters({"machine": "tripod", "actual.geometry.strut": 0.1})


@pytest.mark.parametrize(("key", "value"), [("divide", "frequency"), ("split", 0.3), ("crossover", 2.0)])
def test_what_the_controller_decides_has_no_actual_value(key, value):
    with pytest.raises(
        InputError, match=rf"^actual\.geometry\.{key}: the controller decides it.*; set geometry\.{key}$"
    ):
        setup_from_parameters({"machine": "hybrid", f"actual.geometry.{key}": value})


def test_a_list_of_any_length_has_at_least_one_number():
    @dataclasses.dataclass(frozen=True)
    class Options:
        feeds: tuple[float, ...] = parameter((1.0, 2.0), "feeds", unit="mm/min", above=0.0, any_length=True)

    assert read_section(Options, {"feeds": [3.0]}, "").feeds == (3.0,)
    assert read_section(Options, {"feeds": [3.0, 4, 5.0]}, "").feeds == (3.0, 4.0, 5.0)
    with pytest.raises(InputError, match=r"^feeds: no numbers given"):
        read_section(Options, {"feeds": []}, "")
    with pytest.raises(InputError, match=r"^feeds\[1\]: -1\.0 mm/min is not above 0"):
        read_section(Options, {"feeds": [1.0, -1.0]}, "")
