"""The policies of the package, each with what it must be given."""

from xray_drake.policy.beyond.grasp_aware import GraspAware
from xray_drake.policy.beyond.lookahead import Lookahead
from xray_drake.policy.beyond.oracle import oracle
from xray_drake.policy.ranking import largest, random, xray
from xray_drake.policy.registry import Policy

XRAY = Policy(xray)
LARGEST = Policy(largest, blind=True)
RANDOM = Policy(random, blind=True)
ORACLE = Policy(oracle, truth=True, blind=True)
MEMORY = Policy(xray, memory=True)
LOOKAHEAD = Policy(Lookahead(), outlook=True)
GRASP_AWARE = Policy(GraspAware(), outlook=True)
COMBINED = Policy(GraspAware(Lookahead()), memory=True, outlook=True)
