"""The preprocessor as a node: called by its service over the middleware, heard on its latched topic."""

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from running import command
from std_srvs.srv import Trigger

from pkm_cnc.bag import read_run
from pkm_cnc.config import load_setup
from pkm_cnc.evaluation import evaluate
from pkm_cnc.nodes.compensation_preprocessor import CompensationPreprocessorNode
from pkm_cnc.nodes.message_types import message_class
from pkm_cnc.program import carried_original, read_program


def test_the_graph_runs_the_file_as_the_simulation_does(tmp_path):
    program, output = tmp_path / "a.ngc", tmp_path / "b.ngc"
    program.write_text(TEXT)
    ran, simulated = tmp_path / "ran", tmp_path / "simulated"
    for arguments in (
        ("compensate", program, "-o", output, "--iterations", "1"),
        ("run", output, "--bag", ran),
        ("simulate", output, "--bag", simulated),
    ):
        done = command(*arguments, "--machine", "tripod")
        assert done.returncode == 0, done.stderr
    one, other = read_run(ran), read_run(simulated)
    assert one.servo.keys() == other.servo.keys()
    assert all((one.servo[topic] == other.servo[topic]).all() for topic in one.servo)
    assert [part.line for part in one.slow["toolpath/segment"]] == [2]  # the contour's, not the 100 that are run
    assert evaluate(one).to_json() == evaluate(other).to_json()


MACHINE = {key: value for key, (value, _) in load_setup("tripod").parameters.items()}
TEXT = "G21 G90\nG1 X40 Y10 F6000\nM2\n"


def called(context, parameters):
    """The answer of `~/compensate`, and the elements that a late listener hears."""
    node = CompensationPreprocessorNode(context=context, parameters={**MACHINE, **parameters})
    asker = Node("asker", context=context, use_global_arguments=False)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    executor.add_node(asker)
    try:
        client = asker.create_client(Trigger, "compensation_preprocessor/compensate")
        assert client.wait_for_service(20.0)
        future = client.call_async(Trigger.Request())
        executor.spin_until_future_complete(future, 60.0)
        heard = []
        late = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        kind = message_class("pkm_cnc_msgs/msg/ToolpathSegment")
        asker.create_subscription(kind, "toolpath/compensated", heard.append, late)
        for _ in range(400):
            if not future.result().success or (heard and heard[-1].end.x == 0.04):
                break
            executor.spin_once(0.05)
        return future.result(), heard
    finally:
        node.destroy_node()
        asker.destroy_node()


def test_a_program_in_a_file_and_a_toolpath_out(tmp_path):
    program, output = tmp_path / "a.ngc", tmp_path / "b.ngc"
    program.write_text(TEXT)
    context = Context()
    rclpy.init(args=[], context=context)
    try:
        parameters = {"program": str(program), "output": str(output), "compensation.iterations": 1}
        answer, heard = called(context, parameters)
        assert answer.success, answer.message
        assert answer.message.startswith("largest contour error ")
        assert carried_original(read_program(output)).text == TEXT
        assert [one.index for one in heard] == list(range(len(heard)))
        assert len(heard) > 5

        answer, heard = called(context, {**parameters, "method": "wish", "output": str(tmp_path / "c.ngc")})
        assert (answer.success, heard) == (False, [])
        assert answer.message == "parameter method: 'wish' is not one of mirror, ilc, inverse, zpetc"
        assert not (tmp_path / "c.ngc").exists()
    finally:
        context.try_shutdown()
