"""The policies beyond the paper, each with what it must be given."""

from xray_drake.policy.beyond.grasp_aware import GraspAware
from xray_drake.policy.beyond.lookahead import Lookahead
from xray_drake.policy.beyond.oracle import oracle
from xray_drake.policy.ranking import xray
from xray_drake.policy.registry import Policy

ORACLE = Policy(oracle, truth=True)
MEMORY = Policy(xray, memory=True)
LOOKAHEAD = Policy(Lookahead(), outlook=True)
GRASP_AWARE = Policy(GraspAware(), outlook=True)
COMBINED = Policy(GraspAware(Lookahead()), memory=True, outlook=True)
