# The two main commands are `make demo` and `make test`. Both run `make install` first.
# Each completed step leaves a stamp file in .venv, so that a second run is quick.
SHELL := /bin/bash
PYTHON ?= $(firstword $(wildcard /usr/bin/python3.11) python3.11)
VENV := .venv
BIN := $(VENV)/bin
INTEROP := $(CURDIR)/$(VENV)/interop
WITH_PEERS := FARM_INTEROP=$(INTEROP)/bin/python PATH="$$PATH:$(INTEROP)/bin"
PIP := $(BIN)/python -m pip --disable-pip-version-check install --quiet
SITE := rm -rf build/docs && $(BIN)/sphinx-build -W --keep-going -q -b html docs build/docs
SOURCES := farm drivers decompose slicing
LOCK_OPTIONS := --quiet --generate-hashes --allow-unsafe --strip-extras --all-build-deps --no-header \
	--no-emit-index-url --no-emit-find-links --no-emit-trusted-host --no-emit-options

# Tests start a thousand processes: without stored bytecode, half of each start would be compilation.
export PYTHONDONTWRITEBYTECODE :=

.PHONY: install demo test test-system test-waiting test-rest test-newest fresh interop peers check docs screenshots mutants lock \
	clean engine pages deb test-deb test-container wheel
.DELETE_ON_ERROR:

install: engine pages $(VENV)/.compiled

# Installs CuraEngine and the settings of the same version; quick if they are installed already.
engine:
	@slicing/install-cura.sh .cura/resources

# Bundles the scripts of the pages with their libraries; without node or a network, the pages work without them.
pages: $(VENV)/.installed
	@deploy/build-pages.sh $(BIN)/python

$(VENV)/.installed: requirements.lock pyproject.toml deploy/install-venv.sh
	@PYTHON=$(PYTHON) deploy/install-venv.sh $(VENV)
	@echo "Installing the pinned dependencies into $(VENV) ..."
	@$(PIP) --require-hashes -r requirements.lock
	@$(PIP) --no-deps --no-build-isolation -e .
	@touch $@

# Compiles the planning code to machine code, again after each change of its sources.
$(VENV)/.compiled: $(VENV)/.installed $(shell find decompose -name '*.py')
	@echo "Compiling the planning code: one to five minutes ..."
	@$(BIN)/python -m decompose.compilation
	@touch $@
	@echo "Installed: $(BIN)/farm"

$(VENV)/.installed-dev: requirements-dev.lock $(VENV)/.installed
	@echo "Installing the dependencies of the tests ..."
	@$(PIP) --require-hashes -r requirements-dev.lock
	@touch $@

demo: install
	$(BIN)/python examples/demo.py

# Tests with real processes mostly wait. So they run in parallel with the others; each group is reported when it has ended.
SYSTEM := tests/system tests/farm/web
WAITING := tests/interop tests/farm/agents tests/farm/control tests/farm/http tests/drivers
test: install $(VENV)/.installed-dev peers
	@$(MAKE) --no-print-directory --jobs=3 --output-sync=target test-system test-waiting test-rest

test-system:
	$(BIN)/python -m pytest $(SYSTEM)

test-waiting:
	$(WITH_PEERS) $(BIN)/python -m pytest $(WAITING)

test-rest:
	$(BIN)/python -m pytest tests $(addprefix --ignore=,$(SYSTEM) $(WAITING))

# Runs the tests that start no farm of real processes and whose results may differ with a newer Python.
test-newest: install
	@deploy/test-newest.sh

# Runs both commands in a new Debian 12; needs root; for use before each release. Variants: `make fresh COMMANDS=test`,
# `make fresh SHM=no`, and `make fresh KEEP=FOLDER`, which keeps the root in that folder for the next run.
COMMANDS := demo test
fresh:
	@deploy/fresh.sh $(if $(filter no,$(SHM)),--no-shm) $(if $(KEEP),--keep $(KEEP)) $(COMMANDS)

# Builds build/dist/farm_VERSION_amd64.deb for Debian 12. `make test-deb`, as root, installs, upgrades and purges the package in
# a new Debian 12.
deb: engine pages $(VENV)/.installed
	@deploy/debian/build.sh

test-deb: deb
	@deploy/debian/test.sh

# Builds the container without a registry, as root; its simulated printers print a model.
test-container: deb
	@deploy/container/test.sh

# Builds the wheel, and lists the versions with which it is tested, for pipx and uv.
wheel: pages $(VENV)/.installed
	rm -rf build/lib build/bdist.*
	$(BIN)/python -m pip --disable-pip-version-check wheel --quiet --no-deps --no-build-isolation -w build/dist .
	sed -n 's/^\([A-Za-z0-9_.-]*==[^ ]*\).*/\1/p' requirements.lock > build/dist/constraints.txt

# Runs only the tests against third-party software.
interop: $(VENV)/.installed-dev peers
	$(WITH_PEERS) $(BIN)/python -m pytest tests/interop

# Installs that software, quickly if it is installed already; if it is not available, the tests are skipped.
peers: $(VENV)/.installed-dev
	@PYTHON=$(PYTHON) deploy/install-peers.sh $(INTEROP)

check: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/mypy --config-file bench/mypy.ini bench
	$(BIN)/lint-imports
	$(BIN)/python docs/generate.py --check
	$(SITE)
	.ci/commit-subjects

# Builds the documentation as a site in build/docs/index.html. A broken link is an error.
docs: $(VENV)/.installed-dev
	$(SITE)
	@echo "The documentation is in build/docs/index.html"

# Takes pictures of the dashboard with a daemon, simulated printers and Debian's Chromium; ten minutes on an idle machine.
# If it is interrupted, its farm keeps running, and the next run takes only the missing pictures.
screenshots: $(VENV)/.installed-dev engine pages
	PYTHONPATH=tests/support $(BIN)/python docs/screenshots.py

# Puts deliberate faults into the rules on which prints depend, and lists those that no test detects; about half an hour.
mutants: $(VENV)/mutants/.installed
	nice -n 19 $(VENV)/mutants/bin/python -m bench.mutants --at-once 2

$(VENV)/mutants/.installed: bench/mutants.txt $(VENV)/.installed-dev
	$(PYTHON) -m venv $(VENV)/mutants
	$(VENV)/mutants/bin/python -m pip --disable-pip-version-check install --quiet -r bench/mutants.txt
	@touch $@

# Locks the versions of the dependencies in pyproject.toml; `make lock UPGRADE=--upgrade` takes new versions.
lock:
	scratch=$$(mktemp -d) && trap 'rm -rf "$$scratch"' EXIT && $(PYTHON) -m venv $$scratch && \
	$$scratch/bin/python -m pip install --quiet pip-tools && \
	$$scratch/bin/pip-compile $(LOCK_OPTIONS) $(UPGRADE) -o requirements.lock pyproject.toml && \
	$$scratch/bin/pip-compile $(LOCK_OPTIONS) $(UPGRADE) --extra dev -c requirements.lock \
		-o requirements-dev.lock pyproject.toml

clean:
	rm -rf $(VENV) .cura .demo build ./*.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find $(SOURCES) tests bench examples -name __pycache__ -type d -prune -exec rm -rf {} +
