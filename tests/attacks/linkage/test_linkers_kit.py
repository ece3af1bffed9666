"""The attack kit over the built-in linkers."""

from attacks.linkage.behaviour import Behaviour
from attacks.linkage.dtw import DTW
from attacks.linkage.histogram import Histogram
from attacks.linkage.kinematic import Kinematic
from attacks.linkage.profile import Profile
from attacks.linkage.shape import Shape
from attacks.testing import parametrize_attack_checks


@parametrize_attack_checks([Shape(), Profile(), DTW(), Behaviour(), Histogram(), Kinematic()])
def test_built_in_linker(attack, check):
    check(attack)
