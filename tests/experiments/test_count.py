"""Errors against the number of discs: a tiny film."""

from experiments.count import with_discs


def test_more_discs_are_seen_and_the_bound_sinks():
    few, many = with_discs(16, 0, 36), with_discs(60, 0, 36)
    assert many["rows"]["so3"]["mean_discs"] > 2.0 * few["rows"]["so3"]["mean_discs"]
    for quantity in ("attitude_deg", "rate_deg_s"):
        assert many["bound"][quantity]["combined"] < few["bound"][quantity]["combined"]
    assert many["rows"]["so3"]["tracked"] == 36
