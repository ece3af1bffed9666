"""The kit of the project: every check is a test of its own; `pytest -k NAME` runs it."""

from further_attacks.fusion import Fusion
from further_attacks.imm_rts import ImmRTS
from further_attacks.posterior import Posterior

from attacks.testing import kit_test

# As it is used, `posterior` takes minutes: it draws less here.
test_attack = kit_test(
    ImmRTS(),
    ImmRTS(q=0.1, q_turn=0.3),
    Posterior(draws=20, burn_in=5),
    Fusion(),
)
