"""Which executables make up the graph of a machine, where they stand, and what each must be told."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from pkm_cnc.run_messages import NEUTRAL, RunOptions
from pkm_cnc.topics import INTERPOLATOR, RECORDER, nodes

__all__ = ["GraphNodeSpec", "describe_graph"]


class GraphNodeSpec(NamedTuple):
    """One node to start: executable (and node name), namespace relative to the machine's, run parameters it needs."""

    executable: str
    namespace: str
    parameters: dict[str, str | bool | int]

    @property
    def full_name(self) -> str:
        """Name relative to the machine's namespace, e.g. u1/plant."""
        return f"{self.namespace}/{self.executable}" if self.namespace else self.executable


def describe_graph(
    axes: Sequence[str],
    program: str,
    bag: str,
    pacing: str,
    tcp_control: bool = False,
    options: RunOptions = NEUTRAL,
) -> list[GraphNodeSpec]:
    """The nodes of a machine with these axes that run `program`, paced "fast" or "realtime", recorded to `bag`.

    `tcp_control`: with the controller that looks at the TCP.
    """
    extra: dict[str, dict[str, str | bool | int]] = {
        INTERPOLATOR: {"program": program, "pacing": pacing, **options._asdict()},
        RECORDER: {"bag": bag},
    }
    specs = []
    for name in nodes(axes, tcp_control):
        namespace, _, executable = name.rpartition("/")
        specs.append(GraphNodeSpec(executable, namespace, extra.get(name, {})))
    return specs
