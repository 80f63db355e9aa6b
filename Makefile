# make demo: a simulated treadmill session in the browser, which loses a second on purpose, with a report at the end (make demo DEMO=night: others).
# make lint: style and types.
# make check: these, the laws on three operators (make check OPERATORS="Envelope or Cycles": on others), a quick test of each subject.
# make test: everything that guards a change.
# make nightly: make test and all that takes long: hard nights, long sessions, fuzzing by the minute, peers, every page in the browser.
# make test-peers: software written elsewhere reads what kinegraph writes; installed for the purpose.
# make site: the documentation as a site, in site/. make dist: sdist, wheel, and a wheel with compiled kernels, in dist/.
# Each needs Python >= 3.11 and nothing else; the environment is made in .venv.

PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11 python; do \
	"$$p" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo "$$p" && break; done)
OPERATORS ?= iir.Lowpass or threshold.Threshold or align.Align
SEED ?= 1
MYPY_NUM_WORKERS ?= 2
BIN := .venv/bin

# compiled modules are kept: without them every start of a command reads all of the source again (1.5 s of processor time)
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo lint check test nightly coverage test-peers bench fuzz soak nights audit licences site dist clean

demo: .venv/installed
	@$(BIN)/kinegraph demo $(DEMO)

lint: .venv/installed-for-tests
	$(BIN)/ruff check .
	$(BIN)/mypy --num-workers $(MYPY_NUM_WORKERS)

check: lint
	$(BIN)/pytest -q tests/laws/test_laws.py -k "$(OPERATORS)"
	$(BIN)/pytest -q -m "quick and not nightly"

test: .venv/installed-for-tests
	$(BIN)/kinegraph dev compile operators
	$(BIN)/pytest -n 4 --dist loadgroup

nightly: .venv/installed-for-tests
	$(BIN)/kinegraph dev compile operators
	KINEGRAPH_FUZZ_S=$(FUZZ_S) KINEGRAPH_EXAMPLES=50 $(BIN)/pytest -n 4 --dist loadgroup -m "nightly or not nightly"

# line and branch coverage, by folder; of everything (an hour), or of some: make coverage TESTS=tests/outlets
TESTS ?= tests
coverage: .venv/installed-for-tests
	$(BIN)/python -m pip install --quiet --disable-pip-version-check "coverage>=7.10"
	rm -rf .coverage && mkdir .coverage
	$(BIN)/coverage run -m pytest -q -n 2 --dist loadgroup $(TESTS)
	$(BIN)/coverage combine --quiet
	$(BIN)/coverage report --format=total
	$(BIN)/coverage html --quiet --directory .coverage/html

test-peers: .venv/installed-for-tests
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[test,oak,peers]'
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps bitalino vmcp "osc4py3<1.0.4"
	$(BIN)/kinegraph dev compile operators
	$(BIN)/pytest -n 2 --dist loadgroup -m "nightly or not nightly" tests/peers tests/devices/test_oak.py tests/files/test_depthai_replay.py tests/devices/test_simulators.py \
		tests/files/test_export.py tests/files/test_lab_exports.py tests/sleep/test_night_report.py

# damaged copies of valid files of every format and of every kind of model, FUZZ_S seconds each, others every day
FUZZ_S ?= 60
fuzz: .venv/installed-for-tests
	KINEGRAPH_FUZZ_S=$(FUZZ_S) $(BIN)/pytest tests/files/test_fuzz_files.py tests/files/test_fuzz_models.py tests/page/test_fuzz_view.py -n 2

# all three uses at once in real time under random faults, every sample accounted for; then ten hours of each as fast as they go.
# A week: make soak SOAK_MIN=10080
SOAK_MIN ?= 20
soak: .venv/installed-for-tests
	$(BIN)/python -m tests.soak --minutes $(SOAK_MIN) --seed $(SEED)

# forty simulated nights with power cuts, lamps, partners, nudges and clock changes: every number of each report against the night's log;
# and, as root, power that goes at any moment on a disk, and the service under systemd in a container.
NIGHTS ?= 40
nights: .venv/installed-for-tests
	$(BIN)/python -m pip install --quiet --disable-pip-version-check mfusepy
	KINEGRAPH_NIGHTS=$(NIGHTS) $(BIN)/pytest tests/sleep/test_hard_nights.py tests/sleep/test_power_loss.py tests/sleep/test_service_in_systemd.py -n 2

# known holes in what kinegraph depends on; the tool is installed for the purpose. Which packages the index does not know is said, and is a
# failure. Where the package index is a mirror that does not answer: make audit SERVICE=osv
SERVICE ?= pypi
audit: .venv/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check pip-audit
	$(BIN)/python -m tests.audit --service $(SERVICE)

licences: .venv/installed
	$(BIN)/python -m tests.licences

bench: .venv/installed-for-bench
	$(BIN)/python -m bench --write

site: .venv/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet --config-file docs/site/mkdocs.yml

# the wheel is built from the sdist, which thereby is known to hold all that it takes; then, beside it, one for this Python on Linux x86-64
# that holds compiled kernels: five minutes of a processor for each level of processors
dist: .venv/installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check build
	$(BIN)/python -m build --outdir dist
	$(BIN)/python -m tests.platform_wheel dist

.venv/bin/python:
	@test -n "$(PYTHON)" || { echo "Python 3.11 or newer is needed; name it: make PYTHON=/path/to/python3" >&2; exit 1; }
	@echo "making an environment in .venv and installing into it: a minute or two, once"
	@$(PYTHON) -m venv .venv || { rm -rf .venv; echo "Python's venv module is needed (Debian: apt-get install python3-venv)" >&2; exit 1; }

# Python compiles a module when it is first imported, and keeps it: all of them at once would take ten seconds before the first demo
.venv/installed: .venv/bin/python pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --editable .
	@touch $@

.venv/installed-for-tests: .venv/bin/python pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[test]'
	@touch .venv/installed $@

.venv/installed-for-bench: .venv/bin/python pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[test,bench]'
	@touch .venv/installed .venv/installed-for-tests $@

clean:
	rm -rf .venv site dist .coverage .mypy_cache .ruff_cache .pytest_cache
