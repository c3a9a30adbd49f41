"""Every test on the middleware stands alone: a ROS domain of its own, this machine only, logs in a temporary folder."""

import contextlib
import itertools
import os
import socket
import sys
from collections.abc import Iterator

import pytest

DOMAINS = range(1, 101)
"""Those whose ports lie below the ones that the system hands out to others."""
PORT_OF_DOMAIN_0 = 22119
"""A bound port says that a domain is taken; ament's domain_coordinator, too, asks there."""


@contextlib.contextmanager
def _reserved(domain: int) -> Iterator[bool]:
    with socket.socket() as sign:
        try:
            sign.bind(("127.0.0.1", PORT_OF_DOMAIN_0 + domain))
        except OSError:
            yield False
        else:
            yield True


@pytest.fixture(scope="session", autouse=True)
def _ros_environment(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        patch.setenv("ROS_LOG_DIR", str(tmp_path_factory.mktemp("ros_log")))
        patch.delenv("ROS_STATIC_PEERS", raising=False)
        if "AMENT_PREFIX_PATH" not in os.environ:
            patch.setenv("AMENT_PREFIX_PATH", sys.prefix)
        yield


@pytest.fixture(scope="session")
def _domains():
    first = os.getpid() % len(DOMAINS)
    return itertools.cycle([*DOMAINS[first:], *DOMAINS[:first]])


@pytest.fixture
def ros_domain(_domains, monkeypatch):
    """A ROS domain that no test of any session on this machine uses at the same time, in ROS_DOMAIN_ID.

    The next test gets another one, so that it does not meet the nodes that this one killed.
    """
    for domain in itertools.islice(_domains, len(DOMAINS)):
        with _reserved(domain) as free:
            if free:
                monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
                yield domain
                return
    pytest.fail("every ROS domain is taken")
