"""Policies beyond the paper, which do not succeed more often than X-Ray.

The README's table has the figures: on 300 heaps none of them finds the target
more often; ``grasp_aware`` saves a sixth of an action. They stay as references
(``oracle``) and as what has been tried.
"""
