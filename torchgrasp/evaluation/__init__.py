"""Success tables, intervals, protocols, grasp prediction, comparisons and learning curves.

Numbers alone: pages, plots and films of them are made in report.
"""

from torchgrasp.evaluation.intervals import wilson_interval as wilson_interval
from torchgrasp.evaluation.success import SuccessTable as SuccessTable
