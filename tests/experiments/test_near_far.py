"""Near and far: a short film by all trackers."""

from experiments import near_far


def test_a_wrong_pose_makes_the_attitude_wrong():
    """On the thesis' way about one degree is turned in 0.6 s: by what a pose is off, the attitude is by less."""
    found = near_far.posed("near", 0.6)
    assert found["lost"] == 0
    assert len(found["attitude"]) == 32
    assert found["attitude"] == sorted(found["attitude"])
    assert found["attitude"][-1] > 1.05 * found["attitude"][0]
