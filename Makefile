# Each target first sets up what it needs in .venv; nothing outside this folder is changed, save that test-browser
# installs Chromium and a graphics driver with apt where they are missing.
#   make demo                 calibrate the arm, pick with it, look at the error: runs/demo
#   make test                 style, types, tests
#   make test-slow            what takes more than a second: journeys, whole robots, every page's lines
#   make test-thorough         long forms of checks that also run short: hundreds of arms, thousands of draws; weekly
#   make test-browser         a demo run seen through a viewer and a browser: runs/browser (Debian or Ubuntu)
#   make test-lowest          arms and calibration with the lowest versions that pyproject.toml promises: .venv-lowest
#   make test-referees        patched files of UR5 and Panda against Pinocchio, which are large packages
#   make test-lerobot         LeRobot's own evaluation of its policies on the scene, and the correction of a robot's
#                             targets: .venv-lerobot, of Python 3.12 or newer (PYTHON312=python3.13)
#   make docs                 the site: docs/_build/html/index.html
#   make links                every address that the site names is asked whether it is there
#   make package              wheel and source archive, built twice and compared, and looked through: dist/
#   make licences             the licence of every installed package, as a table
#   make coverage-of-intervals  how often every 95 % interval holds the truth, on data of known truth
#   make claims               draw ten numbers that the pages print, make them again at a fresh seed: docs/claims.md
#   make mutants              change 120 functions drawn at random, one at a time: docs/mutants.md says what the tests
#                             did not notice. Two hours; goes on where it was; ARGS="--count 20 --seed 7"
#   make demo ARGS=--quick    options for the command
#   make ... PYTHON=python3.12  another Python, for a new .venv
#   make ... TORCH=cuda       torch with CUDA, or TORCH=cpu without; left out, as the computer has a driver by NVIDIA

PYTHON ?= python3
PYTHON312 ?= python3.12
ARGS ?=
TORCH ?= auto

VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
RUNTIME := $(VENV)/.runtime
DEVELOPMENT := $(VENV)/.development
BROWSER := $(VENV)/.browser
MUTANTS := $(VENV)/.mutants
REFEREES := $(VENV)/.referees
LEROBOT := $(VENV)-lerobot/.lerobot
DOCS := $(VENV)/.docs
RELEASE := $(VENV)/.release
# Chromium; Mesa's drivers that draw on the processor, for Vulkan (rerun's own viewer) and OpenGL (the browser); a
# library that playwright's driver needs; a screen that is none, and what the viewer's window needs on it.
BROWSER_PACKAGES := chromium mesa-vulkan-drivers libegl1 libgl1-mesa-dri libatomic1 \
	xvfb libxkbcommon-x11-0 libxcursor1 libxi6

# One thread per process: processes with as many threads as cores each would only wait for one another.
TEST_ENVIRONMENT := PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 MKL_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MPLBACKEND=Agg
PYTEST := $(TEST_ENVIRONMENT) $(BIN)/python -m pytest

.PHONY: demo claims docs links package licences test pytest test-slow test-thorough test-lowest test-referees test-lerobot test-browser coverage-of-intervals lint format benchmark mutants clean

demo: $(RUNTIME)
	$(BIN)/pickenv demo --out runs/demo $(ARGS)

# Types take one core for most of a minute; tests begin meanwhile.
test: $(DEVELOPMENT)
	@$(MAKE) --no-print-directory -j 2 lint pytest

pytest: $(DEVELOPMENT)
	$(PYTEST) -n 2 --dist worksteal $(ARGS)

test-thorough: $(DEVELOPMENT)
	$(PYTEST) -m thorough -n 2 --dist worksteal $(ARGS)

test-slow: $(DEVELOPMENT)
	$(PYTEST) -m "slow and not coverage" -n 2 --dist worksteal $(ARGS)

test-referees: $(REFEREES)
	$(PYTEST) -n 2 tests/calibration/delivery $(ARGS)

test-lerobot: $(LEROBOT)
	HF_HUB_OFFLINE=1 $(TEST_ENVIRONMENT) $(VENV)-lerobot/bin/python -m pytest -n 2 -W default tests/lerobot $(ARGS)

test-lowest:
	@$(PYTHON) -m venv --clear $(VENV)-lowest
	@$(VENV)-lowest/bin/python -m pip --disable-pip-version-check --quiet install packaging
	@$(VENV)-lowest/bin/python .ci/lowest_versions.py > $(VENV)-lowest/lowest.txt
	@$(VENV)-lowest/bin/python scripts/install_torch.py cpu $(VENV)-lowest/lowest.txt
	@$(VENV)-lowest/bin/python -m pip --disable-pip-version-check --quiet install -c $(VENV)-lowest/lowest.txt \
		".[all]" hypothesis pytest pytest-benchmark pytest-xdist
	$(TEST_ENVIRONMENT) $(VENV)-lowest/bin/python -m pytest -n 2 -W default tests/arm tests/orchard $(ARGS)

test-browser: $(BROWSER)
	$(BIN)/pickenv demo --out runs/browser
	$(PYTEST) -m browser -n 2 --dist loadfile tests/browser tests/inspect --durations=5 $(ARGS)

claims: $(DEVELOPMENT)
	$(TEST_ENVIRONMENT) $(BIN)/python scripts/claims.py check $(ARGS)

docs: $(DOCS)
	$(TEST_ENVIRONMENT) $(BIN)/python -m sphinx -W --keep-going -q -b html docs docs/_build/html $(ARGS)

links: $(DOCS)
	$(BIN)/python -m sphinx -q -b linkcheck docs docs/_build/linkcheck $(ARGS)

# The time of the last commit stands in the archives, so that whoever builds the same commit gets the same bytes.
package: export SOURCE_DATE_EPOCH := $(shell git log -1 --format=%ct 2>/dev/null || echo 0)
package: $(RELEASE)
	rm -rf dist build/again
	$(BIN)/python -m build --no-isolation --outdir dist >/dev/null
	$(BIN)/python -m build --no-isolation --outdir build/again >/dev/null
	cd dist && for each in *; do cmp $$each ../build/again/$$each || exit 1; done
	$(BIN)/twine check --strict dist/*
	$(BIN)/check-wheel-contents dist
	rm -rf build

licences: $(RELEASE)
	@$(BIN)/pip-licenses --format=markdown

coverage-of-intervals: $(DEVELOPMENT)
	$(PYTEST) -m coverage -n 2 $(ARGS)

lint: $(DEVELOPMENT)
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/codespell
	$(BIN)/python scripts/words.py
	$(BIN)/zizmor --offline --quiet .github

format: $(DEVELOPMENT)
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

benchmark: $(DEVELOPMENT)
	$(PYTEST) -m "" --benchmark-enable --benchmark-only $(ARGS)

mutants: $(MUTANTS)
	$(BIN)/python .ci/mutation/mutants.py $(ARGS)

clean:
	rm -rf $(VENV) $(VENV)-lerobot runs dist build docs/_build docs/_generated .mypy_cache .ruff_cache .pytest_cache .hypothesis .benchmarks
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# torch goes first and alone, at its tested version: an open range makes pip try, and download, several of gigabytes.
$(RUNTIME): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
		echo "pickenv needs Python 3.11 or newer as '$(PYTHON)'; name another with: make PYTHON=/path/to/python" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { \
		echo "'$(PYTHON)' cannot make a virtual environment; on Debian or Ubuntu: apt install python3-venv" >&2; exit 1; }
	@echo "Setting up $(VENV) (once; some minutes, mostly the download of torch)"
	@$(BIN)/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear $(VENV)
	@$(BIN)/python scripts/install_torch.py $(TORCH)
	@$(PIP) install -c constraints.txt -e ".[rl,inspect]"
	@touch $@

$(DEVELOPMENT): $(RUNTIME)
	@$(PIP) install -c constraints.txt -e ".[dev]"
	@touch $@

$(REFEREES): $(DEVELOPMENT)
	@$(PIP) install -c constraints.txt -e ".[referees]"
	@touch $@

# LeRobot holds torch below the version of constraints.txt. torchvision goes with it, as both must be of one build.
$(LEROBOT): pyproject.toml scripts/lerobot_env_pickenv/pyproject.toml
	@$(PYTHON312) -c 'import sys; sys.exit(sys.version_info < (3, 12))' 2>/dev/null || { \
		echo "LeRobot needs Python 3.12 or newer as '$(PYTHON312)'; name another with: make PYTHON312=/path/to/python" >&2; exit 1; }
	@echo "Setting up $(VENV)-lerobot (once; some minutes, mostly the download of torch)"
	@$(PYTHON312) -m venv --clear $(VENV)-lerobot
	@$(VENV)-lerobot/bin/python -m pip --disable-pip-version-check --quiet install --retries 1 --no-deps \
		--extra-index-url https://download.pytorch.org/whl/cpu torch==2.11.0 torchvision==0.26.0
	@$(VENV)-lerobot/bin/python -m pip --disable-pip-version-check --quiet install -e ".[scene]" -e scripts/lerobot_env_pickenv \
		"lerobot[dataset,diffusion,evaluation]==0.6.1" torch==2.11.0 torchvision==0.26.0 \
		hypothesis pytest pytest-benchmark pytest-xdist
	@touch $@

$(DOCS): $(RUNTIME)
	@$(PIP) install -c constraints.txt -e ".[all,docs]"
	@touch $@

$(RELEASE): $(RUNTIME)
	@$(PIP) install -c constraints.txt -e ".[release]"
	@touch $@

$(MUTANTS): $(DEVELOPMENT)
	@$(PIP) install -c constraints.txt -e ".[mutants]"
	@touch $@

$(BROWSER): $(DEVELOPMENT)
	@dpkg-query -W $(BROWSER_PACKAGES) >/dev/null 2>&1 || { \
		if [ "$$(id -u)" = 0 ]; then root=env; else root=sudo; fi; \
		command -v apt-get >/dev/null && command -v $$root >/dev/null || { \
			echo "test-browser needs $(BROWSER_PACKAGES); installing them needs apt, and root or sudo" >&2; exit 1; }; \
		$$root apt-get update -qq && \
		$$root DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $(BROWSER_PACKAGES); }
	@$(PIP) install -c constraints.txt -e ".[browser]"
	@touch $@
