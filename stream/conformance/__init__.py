"""The laws of DESIGN, tried on any operator: `kinegraph try my_module.MyOperator`, or in a test:

for make in trials(MyOperator):
    trial = make()                      # warms up; raises Broken, which says what is wrong, where, and what to do
    for check in checks(trial).values():
        check()
    trial.attempt(random.Random(1).randint)
"""

from stream.conformance.broken import RULES, Broken, Rule
from stream.conformance.chance import Choices, smallest
from stream.conformance.checks import checks
from stream.conformance.lag import lags
from stream.conformance.laws import Conformance, trials
from stream.conformance.whole import hold

__all__ = ["RULES", "Broken", "Choices", "Conformance", "Rule", "checks", "hold", "lags", "smallest", "trials"]
