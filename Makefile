# Targets that a new clone needs. PYTHON is the interpreter that makes the environment.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
OUT    ?= demo
SAMPLE ?= 100
SEED   ?= 1
JOBS   ?= 2
# What takes longest is printed at the end of each part of test-all.
SLOWEST := --durations=60 --durations-min=5
# Simulators whose environments make test-all sets up; make engines has them all, with minutes of kernel builds.
ENGINES     ?= calibration physx sapien
ALL_ENGINES := calibration genesis isaaclab maniskill physx sapien
export GSB_ENVIRONMENTS ?= $(abspath $(VENV))/environments

.PHONY: help install demo test test-all engines environments test-engines test-training coverage mutants lint proto locks figures site man bench clean

help:
	@echo "make demo   install, record 16 envs x 10 runs of inclined-collision with MuJoCo C, evaluate, write a report"
	@echo "make test   install what is missing, run style, types, import contracts and the quick tests"
	@echo "make test-all  every check and test: engines, clusters, kills, limits, every command of the documents"
	@echo "make engines  the same with every simulator that has an environment of its own: gigabytes, and minutes of builds"
	@echo "make coverage  how much of the code the quick tests execute, and what of it they do not"
	@echo "make mutants  SAMPLE=100 SEED=1: how many random mutants of the code the quick tests notice, and which not"
	@echo "make lint   style, types and the import contract"
	@echo "make proto  rebuild the descriptor set after a change of schemas/proto"
	@echo "make locks  pin the environments of simulators anew; INDEX=URL names a package index (PEP 503)"
	@echo "make figures  redraw the tables and the picture of the documents from recordings/"
	@echo "make site   the documents as a static site, with reference pages made of the code"
	@echo "make man    manual pages of the commands"
	@echo "make bench  every performance claim, measured here"

$(VENV)/.installed-demo: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed: make PYTHON=python3.12")'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[mujoco]'
	touch $@

$(VENV)/.installed-test: $(VENV)/.installed-demo
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[test]'
	touch $@

install: $(VENV)/.installed-demo

demo: install
	$(BIN)/gsb-record --sim mujoco --out $(OUT) $(MORE)
	$(BIN)/gsb-eval $(OUT)/*.mcap --html $(OUT)/report --json $(OUT)/results.json

lint: $(VENV)/.installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/mypy docs benchmarks recordings
	$(BIN)/lint-imports

# Hundreds of processes load the same modules, which are compiled once.
test test-all: export PYTHONDONTWRITEBYTECODE :=

# Files of tests are spread over JOBS processes, in their order; those that mind what runs beside them come after.
test: lint
	$(BIN)/python -m pytest -m 'not slow and not alone' -n $(JOBS) --dist loadfile --no-loadscope-reorder

# Installations wait for packages, and checks for a processor: they take turns. Files that hold no test to be run alone
# are not asked for such tests, for all files take half a minute to be read.
test-all:
	$(MAKE) -j $(JOBS) --output-sync lint environments $(VENV)/training/.whole
	$(BIN)/python -m pytest -m 'not alone' $(SLOWEST) -n $(JOBS) --dist loadfile --no-loadscope-reorder
	$(BIN)/python -m pytest -m alone $(SLOWEST) $$(grep -rl --include='*.py' mark.alone tests | sort)
	$(MAKE) -j $(JOBS) --output-sync test-engines test-training

engines:
	$(MAKE) test-all ENGINES="$(ALL_ENGINES)"

environments: $(VENV)/.installed-test
	for engine in $(ENGINES); do $(BIN)/gsb-record --setup $$engine || exit; done

# Tests that load an engine run in its environment, with the tools of testing lent to it. Isaac Lab's tasks need Gymnasium,
# whose numpy is the environment's; recording scenes does not.
OF_TASKS := gymnasium cloudpickle farama-notifications typing-extensions
test-engines: environments
	for engine in $(ENGINES); do \
	  python="$(GSB_ENVIRONMENTS)/$$engine/bin/python"; tools="$(abspath $(VENV))/lent/$$engine"; \
	  test "$$tools/.whole" -nt "$$python" || { rm -rf "$$tools" && "$$python" -m pip install --quiet \
	    --disable-pip-version-check --target "$$tools" -c constraints.txt pytest hypothesis && \
	    { test $$engine != isaaclab || "$$python" -m pip install --quiet --disable-pip-version-check --target "$$tools" \
	      --no-deps -c constraints.txt $(OF_TASKS); } && touch "$$tools/.whole"; } || exit; \
	  PYTHONPATH="$(CURDIR)/src:$(CURDIR):$$tools" "$$python" -P -m pytest tests/recorder/test_$$engine*.py || exit; \
	done

# Tests that train with a library, in an environment that has it and torch; no other test needs them. Two installations of
# this package write to the same folder, so they follow each other.
$(VENV)/training/.whole: pyproject.toml constraints.txt | $(VENV)/.installed-test
	test -x $(VENV)/training/bin/python || $(PYTHON) -m venv $(VENV)/training
	$(VENV)/training/bin/python -m pip install --quiet --disable-pip-version-check -c constraints.txt \
	  -e '.[record]' 'gymnasium[mujoco]' stable-baselines3 torch hypothesis playwright pytest
	touch $@

test-training: $(VENV)/training/.whole
	$(VENV)/training/bin/python -m pytest tests/recorder/test_stable_baselines.py

coverage: $(VENV)/.installed-test
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt coverage
	$(BIN)/coverage erase
	-$(BIN)/coverage run -m pytest -m 'not slow and not alone' -p no:xdist
	$(BIN)/coverage combine --quiet
	$(BIN)/coverage report

# cosmic-ray makes the mutants; nothing else needs it.
mutants: $(VENV)/.installed-test
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt cosmic-ray
	$(BIN)/python -m tests.mutants --sample $(SAMPLE) --seed $(SEED) --jobs $(JOBS) $(MORE)

proto: $(VENV)/.installed-test
	$(BIN)/python schemas/build_descriptors.py

locks: $(VENV)/.installed-test
	$(BIN)/python -m gpusimbench.recorder.environments.lock --index $(INDEX)

figures: install
	$(BIN)/python docs/make_figures.py
	$(BIN)/python docs/make_h200.py
	$(BIN)/python docs/make_physics.py
	$(BIN)/python docs/make_friction.py
	$(BIN)/python docs/make_devices.py
	$(BIN)/python docs/make_models.py
	$(BIN)/python docs/make_metrics.py
	$(BIN)/python docs/make_loop.py

site: $(VENV)/.installed-test
	$(BIN)/python docs/build_site.py site

man: install
	$(BIN)/python docs/make_man.py man

bench: $(VENV)/.installed-test
	$(BIN)/python -m benchmarks.all

clean:
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
