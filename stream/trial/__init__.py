"""The laws of DESIGN, tried on any operator: `kinegraph try my_module.MyOperator`, or in a test:

for make in trials(MyOperator):
    trial = make()                      # warms up; raises Broken, which says what is wrong, where, and what to do
    for check in checks(trial).values():
        check()
    trial.attempt(random.Random(1).randint)
"""

from stream.trial.broken import RULES, Broken, Rule
from stream.trial.chance import Choices, smallest
from stream.trial.checks import checks
from stream.trial.lag import lags
from stream.trial.laws import Trial, trials
from stream.trial.whole import hold

__all__ = ["RULES", "Broken", "Choices", "Rule", "Trial", "checks", "hold", "lags", "smallest", "trials"]
