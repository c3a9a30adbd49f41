"""The transfer function that thesis section 7.6 identified, and why no position loop has it.

Eq. 7-1 closes the loop Kv V(s) / s round a velocity loop V(s) with unit gain at rest. Whatever the parameters are,
D6 = N3, or the axis never arrives, and D5 = N2 + N3 / Kv and D4 = N1 + N2 / Kv, or it is a share of the way off during
the seconds of a motion. Kv is N1 / D3, but for the part T_pi J_e of D3, 1e-7 of it.
"""

from __future__ import annotations

from pkm_cnc.servo import TransferFunction

__all__ = ["IDENTIFIED", "contradictions"]

IDENTIFIED = TransferFunction(
    (4.1e3, 3.99, 6.01e-4),
    (6.265e-5, 0.154, 1.734e2, 4.02e3, 4.01, 6.021e-4),
)
"""N1..N3 and D1..D6 after the first iteration."""


def contradictions(loop: TransferFunction, digits: float = 5e-4) -> dict[str, tuple[float, float]]:
    """What in the coefficients of eq. 7-1 contradicts a position loop closed on a scale: statement -> (is, must be).

    `digits` is the relative rounding of the printed coefficients. Empty for a possible loop of numerator degree 2.
    """
    n1, n2, n3 = loop.numerator
    _, _, d3, d4, d5, d6 = loop.denominator
    kv = n1 / d3
    found = {}
    for name, value, expected in (
        ("N3/D6, gain at rest, G(0)", n3 / d6, 1.0),
        ("N1/D4, gain over the seconds of a motion", n1 / d4, n1 / (n1 + n2 / kv)),
        ("N2/D5", n2 / d5, n2 / (n2 + n3 / kv)),
    ):
        if abs(value - expected) > 2.0 * digits * expected:
            found[name] = (value, expected)
    return found
