"""The launch file, run with stand-ins for the launch packages of ROS: what it starts, with what, when it stops."""

import importlib.util
import sys
import types
from pathlib import Path

import pytest

from pkm_cnc.bringup import describe_graph
from pkm_cnc.config import load_setup
from pkm_cnc.topics import ANYONE, topics

LAUNCH_FILE = Path(__file__).resolve().parents[1] / "launch" / "tripod.launch.py"
AXES = ("u1", "u2", "u3")
EXPECTED = {
    "interpolator",
    "inverse_kinematics",
    *(f"{axis}/{name}" for axis in AXES for name in ("servo_drive", "plant")),
    "contour_monitor",
    "recorder",
}


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
def description(monkeypatch):
    """What the launch file describes: its parts by kind."""
    for name, classes in MODULES.items():
        module = types.ModuleType(name)
        for kind in classes:
            setattr(module, kind, type(kind, (Made,), {}))
        monkeypatch.setitem(sys.modules, name, module)
    sys.modules["launch.substitutions"].LaunchConfiguration = Configuration
    spec = importlib.util.spec_from_file_location("tripod_launch", LAUNCH_FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    parts = {}
    for part in module.generate_launch_description().arguments[0]:
        parts.setdefault(type(part).__name__, []).append(part)
    return parts


def test_arguments(description):
    defaults = {part.arguments[0]: part.keywords.get("default_value") for part in description["DeclareLaunchArgument"]}
    machine = defaults.pop("parameters")
    assert defaults == {"program": None, "bag": None, "pacing": "fast"}
    assert load_setup(machine).machine_name == "tripod"
    assert all(part.keywords["description"] for part in description["DeclareLaunchArgument"])


def _plain(parameters):
    """Parameter file, and parameters; all of these are texts, even a file called 1."""
    file, values = parameters
    assert all(value.keywords == {"value_type": str} for value in values.values())
    return [file, {name: value.arguments[0] for name, value in values.items()}]


def test_nodes(description, tmp_path):
    machine = tmp_path / "mine.yaml"
    machine.write_text(load_setup("tripod", ["drive.kv=25"]).to_yaml())
    (function,) = (part.keywords["function"] for part in description["OpaqueFunction"])
    given = {"program": "star.ngc", "bag": "there", "pacing": "realtime", "parameters": str(machine)}
    nodes = [node.keywords for node in function(given)]
    extra = {f"{node['namespace']}/{node['name']}".lstrip("/"): _plain(node["parameters"]) for node in nodes}
    assert extra.pop("interpolator") == [str(machine), {"program": "star.ngc", "pacing": "realtime"}]
    assert extra.pop("recorder") == [str(machine), {"bag": "there"}]
    assert extra == {name: [str(machine), {}] for name in EXPECTED - {"interpolator", "recorder"}}
    assert {(node["package"], node["name"]) for node in nodes} == {("pkm_cnc", node["executable"]) for node in nodes}


@pytest.mark.parametrize(("status", "stops"), [(0, False), (1, True), (2, True), (-9, True)])
def test_a_failure_stops_the_others_but_the_end_of_the_run_does_not(description, status, stops):
    (handler,) = (part.arguments[0] for part in description["RegisterEventHandler"])
    event = types.SimpleNamespace(returncode=status, process_name="u1/plant")
    actions = handler.keywords["on_exit"](event, None)
    assert bool(actions) == stops
    if stops:
        (timer,) = actions
        assert timer.keywords["period"] > 0.0
        (shutdown,) = timer.keywords["actions"]
        assert "u1/plant" in shutdown.keywords["reason"]


def test_the_graph_is_that_of_the_topic_table():
    """Every publisher and every subscriber of every topic is a node that is started, and the other way round."""
    specs = describe_graph(AXES, "star.ngc", "there", "fast")
    assert {spec.full_name for spec in specs} == EXPECTED
    named = set()
    for topic in topics(AXES).values():
        named |= {topic.publisher, *topic.subscribers}
    assert named - {ANYONE} == EXPECTED
