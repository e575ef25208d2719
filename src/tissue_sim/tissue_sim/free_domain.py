"""A ROS domain nobody on this machine uses."""

from __future__ import annotations

import os
import random
import socket

HIGHEST_DOMAIN = 101
"""Above it, the ports of a domain overlap those Linux hands out by itself."""


def unicast_port(domain: int) -> int:
    """Port on which the first participant of a domain is discovered (RTPS 2.3, 9.6.1.1)."""
    return 7400 + 250 * domain + 10


def is_free(domain: int) -> bool:
    """Whether no participant of a domain runs on this machine."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", unicast_port(domain)))
        except OSError:
            return False
    return True


def choose_domain() -> int:
    """The user's ROS_DOMAIN_ID, or a free domain, which is then set for this process's children.

    Raises:
        RuntimeError: No domain is free.
    """
    chosen = os.environ.get("ROS_DOMAIN_ID", "").strip()
    if chosen.isdecimal():
        return int(chosen)
    candidates = list(range(1, HIGHEST_DOMAIN + 1))
    random.SystemRandom().shuffle(candidates)
    for domain in candidates:
        if is_free(domain):
            os.environ["ROS_DOMAIN_ID"] = str(domain)
            return domain
    raise RuntimeError("no ROS domain is free on this machine; set ROS_DOMAIN_ID")
