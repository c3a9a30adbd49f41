"""The launch files, run with stand-ins for the launch packages of ROS: what they start, with what, when they stop."""

import importlib.util
import sys
import types
from pathlib import Path

import pytest

from pkm_cnc.bringup import describe_graph
from pkm_cnc.config import load_setup, machine_files
from pkm_cnc.errors import InputError
from pkm_cnc.topics import ANYONE, topics

LAUNCH_FILES = Path(__file__).resolve().parents[1] / "launch"
MACHINES = sorted(machine_files())


def expected(axes):
    per_axis = (f"{axis}/{name}" for axis in axes for name in ("servo_drive", "plant"))
    return {"interpolator", "inverse_kinematics", *per_axis, "contour_monitor", "recorder"}


class Made:
    """Whatever the launch file makes: it remembers with what."""

    def __init__(self, *arguments, **keywords):
        self.arguments = arguments
        self.keywords = keywords


class Configuration(Made):
    def perform(self, context):
        return context[self.arguments[0]]


MODULES = {
    "launch": ("LaunchContext", "LaunchDescription"),
    "launch.actions": ("DeclareLaunchArgument", "OpaqueFunction", "RegisterEventHandler", "Shutdown", "TimerAction"),
    "launch.event_handlers": ("OnProcessExit",),
    "launch.events": (),
    "launch.events.process": ("ProcessExited",),
    "launch.substitutions": (),
    "launch_ros": (),
    "launch_ros.actions": ("Node",),
    "launch_ros.parameter_descriptions": ("ParameterValue",),
}


@pytest.fixture
def described(monkeypatch):
    """From the name of a machine to what its launch file describes: its parts by kind."""
    for name, classes in MODULES.items():
        module = types.ModuleType(name)
        for kind in classes:
            setattr(module, kind, type(kind, (Made,), {}))
        monkeypatch.setitem(sys.modules, name, module)
    sys.modules["launch.substitutions"].LaunchConfiguration = Configuration
    monkeypatch.delitem(sys.modules, "pkm_cnc.bringup.launch_file", raising=False)

    def describe(machine):
        path = LAUNCH_FILES / f"{machine}.launch.py"
        spec = importlib.util.spec_from_file_location(f"{machine}_launch", path)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        assert f"{path.name} program:=" in module.__doc__
        parts = {}
        for part in module.generate_launch_description().arguments[0]:
            parts.setdefault(type(part).__name__, []).append(part)
        return parts

    yield describe
    sys.modules.pop("pkm_cnc.bringup.launch_file", None)  # it has the stand-ins


def test_every_machine_has_its_launch_file():
    assert sorted(path.name.removesuffix(".launch.py") for path in LAUNCH_FILES.iterdir()) == MACHINES


@pytest.mark.parametrize("machine", MACHINES)
def test_arguments(described, machine):
    parts = described(machine)["DeclareLaunchArgument"]
    defaults = {part.arguments[0]: part.keywords.get("default_value") for part in parts}
    assert load_setup(defaults.pop("parameters")).to_yaml() == load_setup(machine).to_yaml()
    neutral = {"pacing": "fast", "attended": "false", "from_line": "0"}
    assert defaults == {"program": None, "bag": None, **neutral}
    assert all(part.keywords["description"] for part in parts)


def _plain(parameters):
    """Parameter file, and parameters; all of these keep their types, a file called 1 is a text."""
    file, values = parameters
    assert all(value.keywords == {"value_type": type(value.arguments[0])} for value in values.values())
    return [file, {name: value.arguments[0] for name, value in values.items()}]


@pytest.mark.parametrize("name", MACHINES)
def test_nodes(described, tmp_path, name):
    machine = tmp_path / "mine.yaml"
    machine.write_text(load_setup(name, ["drive.kv=25"]).to_yaml())
    (function,) = (part.keywords["function"] for part in described(name)["OpaqueFunction"])
    given = {"program": "1.10", "bag": "there", "pacing": "realtime", "parameters": str(machine)}
    given |= {"attended": "True", "from_line": "7"}
    nodes = [node.keywords for node in function(given)]
    extra = {f"{node['namespace']}/{node['name']}".lstrip("/"): _plain(node["parameters"]) for node in nodes}
    run = {"program": "1.10", "pacing": "realtime", "attended": True, "from_line": 7}
    assert extra.pop("interpolator") == [str(machine), run]
    assert extra.pop("recorder") == [str(machine), {"bag": "there"}]
    others = expected(load_setup(name).axes) - {"interpolator", "recorder"}
    assert extra == {node: [str(machine), {}] for node in others}
    assert {(node["package"], node["name"]) for node in nodes} == {("pkm_cnc", node["executable"]) for node in nodes}


@pytest.mark.parametrize(("name", "value"), [("attended", "yes"), ("from_line", "-1"), ("from_line", "2.5")])
def test_an_argument_that_means_nothing_is_refused(described, name, value):
    (function,) = (part.keywords["function"] for part in described("tripod")["OpaqueFunction"])
    given = {"program": "p", "bag": "b", "pacing": "fast", "attended": "false", "from_line": "0"}
    with pytest.raises(InputError, match=f"{name}: '{value}' is not "):
        function({**given, "parameters": "tripod", name: value})


@pytest.mark.parametrize(("status", "stops"), [(0, False), (1, True), (2, True), (-9, True)])
def test_a_failure_stops_the_others_but_the_end_of_the_run_does_not(described, status, stops):
    (handler,) = (part.arguments[0] for part in described("tripod")["RegisterEventHandler"])
    event = types.SimpleNamespace(returncode=status, process_name="u1/plant")
    actions = handler.keywords["on_exit"](event, None)
    assert bool(actions) == stops
    if stops:
        (timer,) = actions
        assert timer.keywords["period"] > 0.0
        (shutdown,) = timer.keywords["actions"]
        assert "u1/plant" in shutdown.keywords["reason"]


@pytest.mark.parametrize("axes", [("u",), ("u1", "u2", "u3", "table_x", "table_y")])
def test_the_graph_is_that_of_the_topic_table(axes):
    """Every publisher and every subscriber of every topic is a node that is started, and the other way round."""
    specs = describe_graph(axes, "star.ngc", "there", "fast")
    assert {spec.full_name for spec in specs} == expected(axes)
    named = set()
    for topic in topics(axes).values():
        named |= {topic.publisher, *topic.subscribers}
    assert named - {ANYONE} == expected(axes)
