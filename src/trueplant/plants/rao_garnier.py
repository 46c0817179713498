"""The Rao-Garnier benchmark of continuous-time identification."""

from __future__ import annotations

from trueplant.lti import TransferMatrix
from trueplant.plants.case import Case


def rao_garnier() -> Case:
    """Fourth order with a fast and a slow mode and a zero in the right half-plane; open loop.

    Rao, G. P. and Garnier, H. (2002), Numerical illustrations of the relevance of direct continuous-time model
    identification, 15th IFAC World Congress, Barcelona.

    Natural frequencies 2 and 20 rad/s with damping 0.25 and 0.1, zero at 0.25 rad/s:

    >>> import numpy as np
    >>> g = rao_garnier().model[0, 0]
    >>> slow, fast = (p for p in sorted(g.poles, key=abs) if p.imag > 0)
    >>> [float(np.round(x, 6)) for p in (slow, fast) for x in (abs(p), -p.real / abs(p))]
    [2.0, 0.25, 20.0, 0.1]
    >>> float(np.roots(g.terms[0].num)[0])
    0.25
    """
    return Case(
        name="rao_garnier",
        reference="Rao and Garnier (2002), 15th IFAC World Congress",
        model=TransferMatrix.of([["(-6400 s + 1600)/(s^4 + 5 s^3 + 408 s^2 + 416 s + 1600)"]], "s"),
        plant=None,
        controller=None,
        time_unit="s",
        outputs=(("y", ""),),
        inputs=(("u", ""),),
    )
