PYTHON ?= python3
TORCH := torch==2.13.0
RUN := .venv/bin/python -m
CODE := flexman_gym agents scripts

.PHONY: demo test long kernels quick lint site notebooks pages bundle verify wheel wheels publishable clients evidence clean

demo: .venv/installed
	.venv/bin/flexman demo

# Two processes, each of which needs a core: kernels of both come from one cache. A file of tests stays with one of them,
# so that no kernel is compiled by both at once.
test: lint kernels
	$(RUN) pytest -n 2 --dist loadfile --durations=20 -m "not evidence and not long"

# The tests that take seconds each (tests/long_tests.txt), before a release and after a change of their subject.
long: kernels
	$(RUN) pytest -n 2 --durations=20 -m "long and not evidence"

kernels: .venv/installed
	.venv/bin/python scripts/kernel_uses.py

# The core alone: its tests but for those that take long, with all features blocked and with kernels that are compiled.
quick: .venv/installed
	$(RUN) pytest -q -n 2 --core -m "not slow"

# The site with the notebooks as they are stored, into out/site. It opens from a disk without a network.
site: notebooks pages

# Writes the notebooks of edited tutorials, and runs those whose code has changed.
notebooks: .venv/installed
	.venv/bin/python scripts/notebooks.py

# The site alone. Pages that are older than their code say so at their top.
pages: .venv/installed
	@mkdir -p build/site && ln -sfn ../../flexman_gym build/site/flexman_gym
	@ln -sfn ../../agents build/site/flexman_agents
	timeout 600 $(RUN) zensical build --strict --clean
	$(RUN) studies evidence --notes out/site

# The script of the replay page is what its sources say; left out without a network.
bundle: .venv/installed
	if $(MAKE) scripts/web/node_modules; then .venv/bin/python scripts/bundle.py --check; fi

scripts/web/node_modules: scripts/web/package-lock.json
	cd scripts/web && npm ci --no-audit --no-fund --silent
	@touch $@

verify: .venv/installed
	$(RUN) studies verification --folder docs/evidence

# What a new user does, without the checkout: builds the wheel and installs it, checks, trains and evaluates.
wheel:
	@PYTHON=$(PYTHON) TORCH=$(TORCH) scripts/wheel.sh

# The wheels of a release, into out/wheels: for every platform, and with machine code for Pythons that are found here.
# Fails if numbers of README and home are of old rows; TRIAL=1 builds wheels that are not released.
wheels: .venv/installed
	@mkdir -p out
	@TORCH=$(TORCH) TRIAL=$(TRIAL) scripts/wheels.sh out/wheels

# What a publication still lacks: empty addresses, metadata, long description, licences, contents of the wheel.
publishable: .venv/installed
	.venv/bin/python scripts/publishable.py

# Short training loops of Stable-Baselines3, sb3-contrib, skrl, TorchRL and Tianshou, in an environment of their own.
clients:
	@PYTHON=$(PYTHON) TORCH=$(TORCH) scripts/clients.sh

# Lists the rows, pages, pictures and policies that are older than the code that they describe, with what has changed.
# STUDY="servos faults" makes these studies, STUDY=stale all that are not current; after an interruption the same command
# goes on. The tests compare the stored rows and pages with the code.
evidence: export OMP_NUM_THREADS = 1
evidence: .venv/installed
	$(RUN) studies evidence $(if $(STUDY),--make $(filter-out stale,$(STUDY)))
	$(RUN) pytest -q -n 2 -m evidence

lint: .venv/installed
	$(RUN) ruff check $(CODE) tests
	$(RUN) ruff format --check --quiet $(CODE) tests
	@mkdir -p build/names && ln -sfn ../../agents build/names/flexman_agents
	PYTHONPATH=.:build/names:scripts .venv/bin/lint-imports --no-logo --no-cache
	$(RUN) mypy flexman_gym scripts build/names/flexman_agents tests/oracles/given.py

# torch comes first, as a CPU build where one is provided, so that the training extra does not pull CUDA packages. To compile
# all modules takes as long as to install them. Those that commands import are compiled here, as an environment with
# PYTHONDONTWRITEBYTECODE would compile them in each process: a command starts in a third of that time. Programs of a
# checkout find the package `studies` by a file of paths.
.venv/installed: pyproject.toml
	@echo "Installing flexman_gym and its tools into .venv: once, for a few minutes"
	@$(PYTHON) -m venv .venv
	@$(RUN) pip install --quiet --no-compile $(TORCH)
	@$(RUN) pip install --quiet --no-compile -e '.[train,render,dev,docs]'
	@.venv/bin/python -c "import site; print('$(CURDIR)/scripts', file=open(site.getsitepackages()[0] + '/studies.pth', 'w'))"
	@PYTHONDONTWRITEBYTECODE= .venv/bin/python -c "import flexman_gym, scipy.optimize, matplotlib.pyplot, stable_baselines3"
	@touch $@

# Packages that few tests need: clusters, searches, datasets, and other simulators.
.venv/tested: .venv/installed
	@$(RUN) pip install --quiet --no-compile -e '.[scale,peers]'
	@touch $@

clean:
	rm -rf .venv .cache out build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +
