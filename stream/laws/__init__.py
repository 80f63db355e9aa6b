"""The laws of DESIGN, tried on any operator: `kinegraph dev try my_module.MyOperator`, or in a test:

for make in trials(MyOperator):
    trial = make()                      # warms up; raises Broken, which says what is wrong, where, and what to do
    for check in checks(trial).values():
        check()
    trial.attempt(random.Random(1).randint)
"""

from kinegraph.stream.laws.checks import checks
from kinegraph.stream.laws.delay import lags
from kinegraph.stream.laws.laws import Conformance, trials
from kinegraph.stream.laws.random_cases import Choices, smallest
from kinegraph.stream.laws.snapshots import hold
from kinegraph.stream.laws.violations import RULES, Broken, Rule

__all__ = ["RULES", "Broken", "Choices", "Conformance", "Rule", "checks", "hold", "lags", "smallest", "trials"]
