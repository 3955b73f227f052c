# Start with `make demo` and `make test`. All targets use the virtual environment .venv, which the first target creates.

PYTHON ?= python3
BIN := .venv/bin
TEST_SEED := 1000000  # seed of the first test episode; no policy is tuned or trained on the test episodes

.PHONY: cluster-test rllib-test demo evidence learners task-learners ablations results vehicles tasks bound animation pictures test check static kernels kills format bench time-to-beat accuracy soak golden interruptions docs tour screenshots clean help

DEMO := --settings ppo-alone --total-timesteps 1200000  # about a minute on one core
demo: .venv/.installed  ## train PPO in wind and compare it with ADRC-DESO and the flatness-based controller
	rm -rf runs/demo
	$(BIN)/quadpend train $(DEMO) --out runs/demo
	$(BIN)/quadpend evaluate adrc-paper flatness ppo=runs/demo --scenarios calm windy --episodes 200 --seed $(TEST_SEED) --out results/demo

SEEDS := 0 1 2 3 4
comma := ,
space := $(subst ,, )
evidence: .venv/.installed  ## table of docs/results.md: PPO after a minute of training, five seeds, and two classical controllers
	rm -rf $(SEEDS:%=runs/demo-%)
	$(foreach seed,$(SEEDS),$(BIN)/quadpend train $(DEMO) --seed $(seed) --out runs/demo-$(seed) &&) true
	$(BIN)/quadpend evaluate adrc-paper flatness ppo=$(subst $(space),$(comma),$(SEEDS:%=runs/demo-%)) \
		--scenarios calm windy steady gusts --episodes 200 --seed $(TEST_SEED) --out docs/demo

LEARNERS := apg ppo-alone sac-alone ppo-gain-scheduling ppo-hummingbird sac-hummingbird ppo-swing-up sac-swing-up
learners: .venv/.installed  ## train the learned policies that the package ships with five training seeds each
	rm -rf $(foreach name,$(LEARNERS),$(SEEDS:%=runs/$(name)-%))
	mkdir -p train/quadpend_train/policies/shipped
	$(foreach name,$(LEARNERS),$(foreach seed,$(SEEDS),$(BIN)/quadpend train --settings $(name) --seed $(seed) --out runs/$(name)-$(seed) && \
		cp runs/$(name)-$(seed)/policy.npz train/quadpend_train/policies/shipped/$(name)-$(seed).npz &&)) true

ONE_SEED := ppo-load sac-load ppo-recovery sac-recovery ppo-agile sac-agile  # ppo-recovery starts from ppo-swing-up-0
task-learners: .venv/.installed  ## train the learned policies of the other tasks that the package ships with one training seed
	$(MAKE) learners SEEDS=0 LEARNERS="$(ONE_SEED)"

ablations: .venv/.installed  ## section of docs/results.md that compares trainings with and without single settings
	$(BIN)/quadpend ablate --document docs/results.md

LEARNED := apg ppo-alone sac-alone ppo-gain-scheduling
CLASSICAL := dual-mode flatness mppi lqi lqr adrc-matched adrc-tuned adrc-linear adrc-paper
results: .venv/.installed  ## docs/results.md: learned policies and classical controllers in all test scenarios
	$(BIN)/quadpend evaluate $(LEARNED) $(CLASSICAL) --scenarios test --episodes 200 --seed $(TEST_SEED) --jobs 2 \
		--robustness 50 --bound docs/bound/bound.csv --out docs/results --document docs/results.md
	$(BIN)/quadpend evaluate dual-mode flatness adrc-paper $(LEARNED) --scenarios hover hover_windy --episodes 200 --seed $(TEST_SEED) --out docs/hover
	$(BIN)/quadpend situation apg --episodes 200 --seed $(TEST_SEED) --jobs 2 --out docs/situation --document docs/results.md

FLYERS := flatness lqi lqr adrc-matched
vehicles: .venv/.installed  ## docs/vehicles-results.md: real vehicles in wind, from large tilts, and as flown in an experiment
	$(BIN)/quadpend vehicles $(FLYERS) --parts as-flown --episodes 200 --seed $(TEST_SEED) --jobs 2 --out docs/vehicles-results --document docs/vehicles-results.md
	$(BIN)/quadpend vehicles $(FLYERS) ppo-hummingbird sac-hummingbird --parts presets recovery leaderboard --episodes 100 --seed $(TEST_SEED) --jobs 2 \
		--out docs/vehicles-results --document docs/vehicles-results.md

PARTS := swing-up load recovery agile
tasks: .venv/.installed  ## docs/tasks-results.md: swing-up, hanging load, recovery and fast references
	$(foreach part,$(PARTS),$(BIN)/quadpend tasks $(part) --episodes 200 --seed $(TEST_SEED) --jobs 2 \
		--out docs/tasks-results --document docs/tasks-results.md &&) true

bound: .venv/.installed  ## docs/bound.md: the best flights of episodes whose wind is known in advance, and the gap to them
	$(BIN)/quadpend bound flatness dual-mode apg ppo-gain-scheduling --scenarios test windy --episodes 8 --seed $(TEST_SEED) --out docs/bound --document docs/bound.md

animation: .venv/.installed  ## animations of the README (a gust, at half speed) and of docs/tasks.md (the swing-up)
	$(BIN)/quadpend watch ADRC-DESO=adrc-paper PPO=ppo-gain-scheduling-0 --scenarios docs/gust.toml --seconds 1.5 5 --speed 0.5 \
		--zoom 1.4 --fps 16.7 --size 960 560 --out docs/gust.gif
	$(BIN)/quadpend watch Planned=swing-up --scenarios swing_up_breeze --seconds 0 3 --speed 0.4 \
		--zoom 1.3 --fps 12.5 --size 480 360 --out docs/swing_up.gif

pictures: .venv/.installed  ## figures of docs/models.md and docs/trajectories.md
	$(BIN)/quadpend wind --out docs/models
	$(BIN)/python -m docs.tools.trajectories

WORKERS := auto  # processes that run the tests; 0 runs them in one process
test: .venv/.installed kernels  ## run the tests
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder

check: .venv/.installed  ## run what CI runs: format, lint, types, docs, tests
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(MAKE) --jobs 2 static test

static: .venv/.installed  # the checks of `make check` that run beside the kernels and the tests
	$(BIN)/mypy
	$(MAKE) docs

cluster-test: .venv-ray/.installed kernels  ## run the tests that need Ray, on a local cluster of two nodes
	OMP_NUM_THREADS=1 .venv-ray/bin/python -m pytest tests/quadpend_train/common/test_ray_executor.py
	OMP_NUM_THREADS=1 .venv-ray/bin/python -m pytest tests/quadpend_train/studies/search/test_sweep.py -k ray_tune

rllib-test: .venv-rllib/.installed kernels  ## run the tests that need RLlib, which pins an older Gymnasium
	OMP_NUM_THREADS=1 .venv-rllib/bin/python -m pytest tests/project/test_rllib.py

kernels: .venv/.installed  # compile the kernels once, so that the processes of `make test` find them in the cache
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.helpers.kernels

kills: .venv/.installed kernels  ## kill train, evaluate and tune at each of their file operations, and run them again
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.helpers.kills

format: .venv/.installed  ## format the code and fix what ruff can fix
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

docs: .venv/.installed  ## build the documentation site in site/; a broken link or a missing reference is an error
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

tour: .venv/.installed  ## docs/tour.ipynb: run docs/tour.py as a notebook, with its outputs
	$(BIN)/python -m docs.tools.notebook

screenshots: .venv/.installed  ## pictures of TensorBoard and of the report page in docs/; needs Chromium
	$(BIN)/python -m docs.tools.screenshots

bench: .venv/.installed  ## docs/bench.md: speed of the environments, compared with others
	$(BIN)/python -m benchmarks.speed --out docs/bench.json

time-to-beat: .venv/.installed  ## docs/time_to_beat.md: training time until a policy balances and beats classical controllers
	$(BIN)/python -m benchmarks.time_to_beat --out docs/time_to_beat.json

accuracy: .venv/.installed  ## docs/accuracy.md: energy drift, distance from MuJoCo, coverage of intervals, error rates of tests
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.accuracy

soak: .venv/.installed  ## docs/soak.md: everything for an hour on two cores
	OMP_NUM_THREADS=1 $(BIN)/python -m benchmarks.soak --document docs/soak.md

golden: .venv/.installed  ## hashes of results: written on the first run, compared on the next; run before and after a refactoring
	$(BIN)/python -m benchmarks.golden

interruptions: .venv/.installed  ## interrupt commands at random moments, resume them and compare the results; about half an hour
	$(BIN)/python -m benchmarks.interruptions

help:  ## list the targets
	@sed -n 's/^\([a-z-]*\):.*  ## \(.*\)/  \1\t\2/p' $(MAKEFILE_LIST) | expand -t 18

clean:  ## delete the caches of numba and of the tools
	find . -name __pycache__ -not -path './.venv*' -prune -exec rm -rf {} +
	rm -rf site .pytest_cache .mypy_cache .ruff_cache .hypothesis build *.egg-info

# Ray, with the packages of .venv, whose versions it must not change; and RLlib, with a Gymnasium of its own.
RAY_CONSTRAINTS := --constraint constraints.txt
RAY_EXTRAS := client,tune
.venv-rllib/.installed: RAY_CONSTRAINTS :=
.venv-rllib/.installed: RAY_EXTRAS := rllib
.venv-ray/.installed .venv-rllib/.installed: .venv/.installed
	$(PYTHON) -m venv $(@D)
	$(@D)/bin/python -c 'import sysconfig as s; open(s.get_path("purelib") + "/main.pth", "w").write("import site; site.addsitedir(\"" + s.get_path("purelib").replace("$(@D)", ".venv") + "\")\n")'
	$(@D)/bin/python -m pip install --quiet $(RAY_CONSTRAINTS) 'ray[$(RAY_EXTRAS)]>=2.40'
	touch $@

.venv/.installed: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit("Python 3.10 or newer is needed, not " + sys.version.split()[0] if sys.version_info < (3, 10) else 0)'
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[train,view,dev,docs]'
	touch $@
