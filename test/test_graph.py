"""The graph on the real middleware: the same numbers as the simulation, however it is started, paced and spread."""

import gc
import itertools
import math
import os
import signal
import time
from functools import partial

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from graph import RELIABLE, TOPICS, ros_context, run_graph, run_in_order, simulated, visitor
from hypothesis import given, settings
from hypothesis import strategies as st
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import ParameterType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.task import Future
from rosbags.highlevel import AnyReader
from rosgraph_msgs.msg import Clock
from running import AXES, LONG, SHORT, command, messages, servo_messages

from pkm_cnc.bag import read_run
from pkm_cnc.config import load_setup, machine_files
from pkm_cnc.messages import typestore
from pkm_cnc.nodes.inverse_kinematics import InverseKinematicsNode
from pkm_cnc.nodes.message_types import message_class
from pkm_cnc.nodes.plant import PlantNode
from pkm_cnc.nodes.recorder import RecorderNode
from pkm_cnc.nodes.runner import make_executor
from pkm_cnc.topics import nodes, topics

SERVO_TOPICS = ["/tcp/setpoint", *(f"/{axis}/{name}" for axis in AXES for name in ("setpoint", "command", "actual"))]
SERVO_TOPICS += ["/tcp/state", "/contour_error"]


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    path = tmp_path_factory.mktemp("program") / "short.ngc"
    path.write_text(SHORT)
    return path


@pytest.fixture(scope="module")
def reference(program, tmp_path_factory):
    """The bag of the simulation."""
    bag = tmp_path_factory.mktemp("reference") / "bag"
    simulated(program, bag)
    return bag


def assert_same_run(bag, reference):
    ours, theirs = servo_messages(bag), servo_messages(reference)
    assert sorted(ours) == sorted(theirs) == sorted(SERVO_TOPICS)
    for topic, expected in theirs.items():
        assert ours[topic] == expected, topic


def test_a_run_leaves_no_threads_of_the_middleware_behind(ros_domain, tmp_path):
    """They would be at work while the process ends and takes their data away, which crashes some processes."""

    def threads_after_a_run(bag):
        program = tmp_path / "short.ngc"
        program.write_text("G1 X0.1 F6000\nM2\n")
        assert run_graph(program, tmp_path / bag).completed
        gc.collect()
        return len(os.listdir("/proc/self/task"))

    assert threads_after_a_run("first") == threads_after_a_run("second")


# The same numbers -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("window", [1, None, 64])
def test_the_graph_equals_the_simulation_bit_for_bit(ros_domain, program, reference, tmp_path, window):
    overrides = [] if window is None else [f"graph.window={window}"]
    end = run_graph(program, tmp_path / "bag", *overrides)
    assert end.completed, end
    assert_same_run(tmp_path / "bag", reference)


def test_two_runs_of_the_graph_are_equal_in_every_topic_they_record(ros_domain, program, reference, tmp_path):
    for name in ("first", "second"):
        assert run_graph(program, tmp_path / name).completed
    first, second = messages(tmp_path / "first"), messages(tmp_path / "second")
    assert first == second
    plain = messages(reference)
    assert set(plain) == set(first)
    assert {topic for topic in plain if plain[topic] != first[topic]} == {"/run_end"}


def test_a_drive_with_everything_on_gives_the_same_in_the_graph(ros_domain, program, tmp_path):
    overrides = [
        "drive.velocity_feed_forward=0.9",
        "drive.acceleration_feed_forward=0.0004",
        "u2.drive.kind=first_order",
    ]
    overrides += ["drive.setpoint_delay=0.0017", "drive.equivalent_delay=0.0008", "u1.drive.position_form=serial"]
    overrides += [
        "drive.position_integral_time=0.3",
        "drive.position_derivative_time=0.002",
        "drive.velocity_limit=0.06",
    ]
    simulated(program, tmp_path / "simulated", *overrides)
    end = run_graph(program, tmp_path / "graph", *overrides)
    assert end.completed, end
    assert_same_run(tmp_path / "graph", tmp_path / "simulated")


@pytest.mark.parametrize("processes", ["one", "each"])
def test_controllers_at_the_tcp_give_the_same_in_the_graph(ros_domain, program, tmp_path, processes):
    """A node and a topic per axis more."""
    overrides = ["tcp_control.adapted_gain=true", "tcp_control.cross_coupling=50"]
    simulated(program, tmp_path / "simulated", *overrides)
    options = [part for override in overrides for part in ("--set", override)]
    done = command(
        *("run", program, "--machine", "tripod", "--bag", tmp_path / "graph", "--processes", processes), *options
    )
    assert (done.returncode, done.stderr) == (0, "")
    ours, theirs = servo_messages(tmp_path / "graph"), servo_messages(tmp_path / "simulated")
    assert set(theirs) == {*SERVO_TOPICS, *(f"/{axis}/correction" for axis in AXES)}
    assert ours == theirs


def test_one_process_per_node_gives_the_same(ros_domain, program, reference, tmp_path):
    done = command("run", program, "--machine", "tripod", "--bag", tmp_path / "bag", "--processes", "each")
    assert (done.returncode, done.stderr) == (0, "")
    assert_same_run(tmp_path / "bag", reference)


def test_realtime_takes_as_long_as_the_machine_and_gives_the_same(ros_domain, program, reference, tmp_path):
    started = time.monotonic()
    end = run_graph(program, tmp_path / "bag", pacing="realtime")
    assert end.completed
    assert time.monotonic() - started >= end.cycle * 0.001
    assert_same_run(tmp_path / "bag", reference)


@pytest.mark.parametrize("machine", sorted(machine_files()))
def test_every_machine_gives_the_same(ros_domain, tmp_path, machine):
    setup = load_setup(machine)
    start = dict(zip("xyz", setup.start_pose, strict=True))
    there = " ".join(f"{name.upper()}{1e3 * start[name] + 2.0:.6f}" for name in setup.kinematics.coordinates)
    program = tmp_path / "there_and_back.ngc"
    program.write_text(f"G21 G90\nG1 {there} F6000\nG1 X{1e3 * start['x']:.6f} F3000\nM30\n")
    simulated(program, tmp_path / "simulated", machine=machine)
    end = run_graph(program, tmp_path / "graph", machine=machine)
    assert end.completed, end
    ours, theirs = messages(tmp_path / "graph"), messages(tmp_path / "simulated")
    assert set(ours) == set(theirs)
    assert {topic for topic in ours if ours[topic] != theirs[topic]} == {"/run_end"}  # which says who ended it


ORDERS = {
    "backwards, the plant of u2 late": (tuple(reversed(nodes(AXES))), "u2/plant"),
    "in order, the interpolator late": (nodes(AXES), "interpolator"),
    "recorder first, contour_monitor late": ((nodes(AXES)[-1], *nodes(AXES)[:-1]), "contour_monitor"),
    "shuffled, the recorder late": (nodes(AXES)[::3] + nodes(AXES)[1::3] + nodes(AXES)[2::3], "recorder"),
}


@pytest.mark.parametrize("name", ORDERS)
def test_who_comes_when_does_not_matter(ros_domain, program, reference, tmp_path, name):
    end = run_in_order(program, tmp_path / "bag", *ORDERS[name])
    assert end.completed, end
    assert_same_run(tmp_path / "bag", reference)


# What crosses the topics ----------------------------------------------------------------------------------------------


def test_typed_publishers_of_others_are_understood(ros_domain):
    """What a message of ROS becomes on the wire is what the codec reads: the size and the end included."""
    fixed = {topic.typename: topic for topic in TOPICS.values() if topic.fixed_size}
    received = {}
    with ros_context() as context:
        node = Node("typed", context=context)
        executor = make_executor(context)
        executor.add_node(node)
        speakers = {}
        for number, (typename, topic) in enumerate(fixed.items()):
            kind = message_class(typename)
            hear = partial(received.setdefault, typename)
            node.create_subscription(kind, f"typed_{number}", hear, RELIABLE, raw=True)
            speakers[node.create_publisher(kind, f"typed_{number}", RELIABLE)] = (kind, topic)
        deadline = time.monotonic() + 20
        while len(received) < len(fixed) and time.monotonic() < deadline:
            for speaker, (kind, topic) in speakers.items():
                message = kind(cycle=1841)
                message.header.frame_id = topic.frame_id
                speaker.publish(message)
            executor.spin_until_future_complete(Future(), 0.05)
    assert set(received) == set(fixed)
    for typename, data in received.items():
        assert fixed[typename].codec.unpack(data)[0] == 1841


# ROS manners ----------------------------------------------------------------------------------------------------------


def call(executor, client, request):
    assert client.wait_for_service(20)
    future = client.call_async(request)
    executor.spin_until_future_complete(future, 20)
    return future.result()


def answer(executor, future):
    executor.spin_until_future_complete(future, 20)
    return future.result()


@pytest.fixture
def served(ros_domain):
    """An unconfigured node with a life of its own, one that asks, and what spins both."""
    parameters = {key: value for key, (value, _) in load_setup("tripod").parameters.items()}
    with ros_context() as context:
        node = InverseKinematicsNode("inverse_kinematics", context=context, parameters={**parameters, "drive.kv": 25.0})
        asker = Node("asker", context=context)
        executor = make_executor(context)
        executor.add_node(node)
        executor.add_node(asker)
        yield node, asker, executor


def test_parameters_are_declared_with_meaning_unit_and_range_and_are_read_only(served):
    node, asker, executor = served
    node.trigger_configure()
    client = AsyncParameterClient(asker, "inverse_kinematics")
    assert client.wait_for_services(20)
    setup = load_setup("tripod")
    names = list(setup.parameters)
    assert set(names) <= set(answer(executor, client.list_parameters()).result.names)
    kinds = {
        bool: ParameterType.PARAMETER_BOOL,
        int: ParameterType.PARAMETER_INTEGER,
        float: ParameterType.PARAMETER_DOUBLE,
        str: ParameterType.PARAMETER_STRING,
        tuple: ParameterType.PARAMETER_DOUBLE_ARRAY,
    }
    for descriptor in answer(executor, client.describe_parameters(names)).descriptors:
        value, spec = setup.parameters[descriptor.name]
        assert descriptor.type == kinds[type(value)], descriptor.name
        assert descriptor.read_only
        assert spec.doc in descriptor.description
        assert not spec.unit or f"[{spec.unit}]" in descriptor.description
        if spec.minimum is not None and spec.maximum is not None and type(value) in (int, float):
            (bounds,) = descriptor.integer_range or descriptor.floating_point_range
            assert (bounds.from_value, bounds.to_value) == (spec.minimum, spec.maximum)
    values = answer(executor, client.get_parameters(["drive.kv", "geometry.azimuth"])).values
    assert values[0].double_value == 25.0
    assert list(values[1].double_array_value) == pytest.approx([math.radians(angle) for angle in (45, 165, 285)])
    (result,) = answer(executor, client.set_parameters([Parameter("drive.kv", value=30.0)])).results
    assert not result.successful
    assert "read-only" in result.reason
    assert answer(executor, client.get_parameters(["drive.kv"])).values[0].double_value == 25.0


@pytest.mark.parametrize("end", ["a fault", "deactivated in the middle of a run"])
def test_the_life_of_a_node_is_one_run(served, end):
    node, asker, executor = served
    state = asker.create_client(GetState, "inverse_kinematics/get_state")
    change = asker.create_client(ChangeState, "inverse_kinematics/change_state")

    def now():
        return call(executor, state, GetState.Request()).current_state.id

    def do(transition):
        return call(executor, change, ChangeState.Request(transition=Transition(id=transition))).success

    assert now() == State.PRIMARY_STATE_UNCONFIGURED
    assert do(Transition.TRANSITION_CONFIGURE)
    assert now() == State.PRIMARY_STATE_INACTIVE
    assert do(Transition.TRANSITION_ACTIVATE)
    assert now() == State.PRIMARY_STATE_ACTIVE
    if end == "a fault":
        node.fail("something broke")
        node.leave()
    else:
        do(Transition.TRANSITION_DEACTIVATE)
    assert now() == State.PRIMARY_STATE_FINALIZED
    assert not node.ended.completed


@pytest.mark.parametrize(
    ("kind", "name", "namespace", "parameters", "reason"),
    [
        (InverseKinematicsNode, "inverse_kinematics", "", {"drive.kw": 20.0}, "drive.kw: unknown parameter"),
        (InverseKinematicsNode, "inverse_kinematics", "", {"drive.kv": -1.0}, "drive.kv: -1.0 1/s is"),
        (PlantNode, "plant", "u4", {}, "plant: namespace /u4 must end in an axis (u1, u2, u3)"),
        (RecorderNode, "recorder", "", {}, "parameter bag is missing"),
    ],
)
def test_what_is_refused_leaves_the_node_unconfigured(ros_domain, kind, name, namespace, parameters, reason):
    with ros_context() as context:
        node = kind(name, context=context, namespace=namespace, parameters={"machine": "tripod", **parameters})
        node.trigger_configure()
        asker = Node("asker", context=context)
        executor = make_executor(context)
        executor.add_node(node)
        executor.add_node(asker)
        path = f"/{namespace}/{name}/get_state".replace("//", "/")
        state = call(executor, asker.create_client(GetState, path), GetState.Request())
    assert state.current_state.id == State.PRIMARY_STATE_UNCONFIGURED
    assert node.ended.exit_code == 2
    assert reason in node.ended.reason


def test_the_clock_ticks_a_hundred_times_a_second_of_machine_time_and_everyone_tells_how_it_is(ros_domain, tmp_path):
    (tmp_path / "long.ngc").write_text(LONG)
    with visitor() as guest:
        clock, diagnostics = guest.hear("/clock", Clock), guest.hear("/diagnostics", DiagnosticArray)

        def told():
            return {status.name: status for report in diagnostics for status in report.status}

        def tick(cycle):
            guest.spin()
            if len(clock) > 30 and len(told()) == len(nodes(AXES)):
                os.kill(os.getpid(), signal.SIGTERM)

        overrides = ("graph.watchdog=4",)
        end = run_graph(tmp_path / "long.ngc", tmp_path / "bag", *overrides, pacing="realtime", tick=tick)
        stamps = [message.clock.sec * 10**9 + message.clock.nanosec for message in clock]
        running = {name: status.level for name, status in told().items()}
    assert end.reason == "stopped by SIGTERM"
    assert all(stamp % 10_000_000 == 0 for stamp in stamps)
    assert {later - earlier for earlier, later in itertools.pairwise(stamps)} == {10_000_000}
    assert set(running) == {f"pkm_cnc: {name}" for name in nodes(AXES)}
    assert set(running.values()) <= {DiagnosticStatus.OK, DiagnosticStatus.ERROR}


# What tools show ------------------------------------------------------------------------------------------------------


def test_the_bag_holds_what_tools_draw(reference):
    """Of the simulation's bag; the graph's holds the same bytes."""
    run = read_run(reference)
    cycles = run.cycles()
    found = {}
    with AnyReader([reference], default_typestore=typestore()) as reader:
        for connection, stamp, data in reader.messages():
            if connection.topic in ("/markers", "/joint_states", "/tcp/pose", "/tcp/path"):
                content = reader.deserialize(data, connection.msgtype)
                found.setdefault(connection.topic, {})[stamp // 1_000_000] = content
    assert sorted(found["/joint_states"]) == sorted(found["/tcp/pose"]) == list(range(0, cycles, 40))
    assert sorted(found["/markers"]) == sorted(found["/tcp/path"]) == list(range(0, cycles, 200))
    for cycle, content in found["/joint_states"].items():
        assert list(content.name) == list(AXES)
        assert list(content.position) == [run.servo[f"{axis}/actual"]["position"][cycle] for axis in AXES]
    for cycle, content in found["/tcp/pose"].items():
        assert content.header.frame_id == "base_link"
        position, row = content.pose.position, run.servo["tcp/state"][cycle]
        assert (position.x, position.y, position.z) == tuple(row[f"position.{axis}"] for axis in "xyz")
        assert content.pose.orientation.w == 1.0
    for cycle, content in found["/markers"].items():
        check_markers({marker.ns: marker for marker in content.markers}, run, cycle)


def check_markers(markers, run, cycle):
    assert set(markers) == {"frame", "sliders", "struts", "platform", "programmed path", "actual path"}
    sliders = [(point.x, point.y, point.z) for point in markers["sliders"].points]
    assert [point[2] for point in sliders] == [run.servo[f"{axis}/actual"]["slider_position"][cycle] for axis in AXES]
    assert [math.hypot(point[0], point[1]) for point in sliders] == pytest.approx([0.513] * 3)
    ends = [(point.x, point.y, point.z) for point in markers["struts"].points]
    lengths = [math.dist(one, other) for one, other in zip(ends[::2], ends[1::2], strict=True)]
    assert lengths == pytest.approx([0.6] * 3, abs=1e-6)
    assert all(marker.header.frame_id == "base_link" for marker in markers.values())
    assert all(
        len(marker.points) % 2 == 0 for name, marker in markers.items() if name not in ("sliders", "actual path")
    )
    radii = [math.hypot(point.x - 0.003, point.y - 0.002) for point in markers["programmed path"].points]
    assert min(radii) <= 0.003 + 1e-9


@settings(derandomize=True, max_examples=20)
@given(st.lists(st.sampled_from(["u1", "u2", "u3", "x", "y", "z", "u"]), min_size=1, max_size=3, unique=True))
def test_the_topic_table_is_whole_for_any_axes(axes):
    table, everyone = topics(axes), set(nodes(axes))
    for topic in table.values():
        assert set(topic.subscribers) <= everyone
        assert topic.publisher in everyone | {"*"}
    assert len([topic for topic in table.values() if topic.record]) == 3 + 3 * len(axes)
