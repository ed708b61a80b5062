"""A sample of the control socket as a short row, for a client that draws many of them."""

import math
from typing import Any

_NONE = [None] * 3


def row_of(sample: dict[str, Any]) -> list[Any]:
    """Return a sample in the form of `frame`: stamp, ball, confirmed, quaternion, rate and its standard deviations,
    counts, latency, discs, position. Unknown values are None. Units as in docs/samples.md.
    """
    covariance = sample.get("rate_covariance")
    sigma = [math.sqrt(max(0.0, covariance[k][k])) for k in range(3)] if covariance else _NONE
    return [
        sample["stamp"],
        sample["ball"],
        sample["confirmed"],
        *(sample.get("quaternion") or [None] * 4),
        *(sample.get("rate") or _NONE),
        *sigma,
        *sample["counts"],
        sample.get("latency"),
        sample.get("statistics", {}).get("discs_used"),
        *(sample.get("position") or _NONE),
    ]
