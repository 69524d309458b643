# `make run` and `make test` set up everything they need; they require make and Python 3.11 or newer.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
CORE   := $(VENV)/.core-installed
READY  := $(VENV)/.plough_opt-installed
DOCS   := $(VENV)/.docs-installed
LIVE   := out/live/cotton.html
PEERS  := $(VENV)/.peers-installed
LOWEST := .venv-lowest
DIST   := .venv-dist

# What `make test` installs beside the core: `make test EXTRA=test` leaves out OpenMDAO, FMU, MPI and cluster, and their tests.
EXTRA  ?= full
PIP     = $(BIN)/uv pip install --quiet --python $(BIN)/python

# At least one test file for every dependency, and quick ones otherwise.
FAST   := $(addprefix tests/,problem_file cli export study calibration/test_linear.py design/test_design_solve.py \
          motion/test_simulate.py uncertainty/test_distributions.py test_layout.py test_forces.py \
          test_component.py test_plots.py test_results.py test_source_equations.py)

# Without bytecode, as in some containers, every process compiles its libraries anew, which trebles the time of imports.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: run test docs thorough slow bench lowest dist lines mutants clean

# The core alone is installed, or what is there already is used.
run: $(if $(wildcard $(READY)),$(READY),$(CORE))
	$(BIN)/plough-opt optimise problems/cotton_subsoiler.toml --plot out/cotton_subsoiler.png

test: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/pytest -n auto --dist worksteal

# The documentation as a site in out/site, which needs no network to build or to read; then its test in a browser, the code of its
# pages that `make test` leaves out, and its notebooks, which must print what they are stored with.
docs: $(DOCS) $(LIVE)
	rm -rf out/site
	$(BIN)/python docs/stage.py
	$(BIN)/sphinx-build -W --keep-going -E -q -c docs -d out/doctrees out/source out/site
	$(BIN)/pytest -q -n auto --dist worksteal -m site tests/site tests/test_pages.py

# The live page on the front page.
$(LIVE): $(DOCS) problems/cotton_subsoiler.toml $(shell find plough_opt -type f -not -name '*.pyc')
	$(BIN)/plough-opt explore problems/cotton_subsoiler.toml -q -o $@

# The tests that `make test` leaves out for time; .ci/run runs both.
thorough: $(READY)
	$(BIN)/pytest -n auto --dist worksteal -m "thorough and not slow and not bench and not site"

slow: $(READY)
	$(BIN)/pytest -n auto --dist worksteal -m "(slow or not bench) and not site"

bench: $(PEERS)
	$(BIN)/pytest -m bench tests/benchmarks --benchmark-columns=min,median,iqr,rounds --benchmark-sort=name

# Test with the oldest versions that pyproject.toml allows, in a separate environment.
lowest:
	$(PYTHON) -m venv --clear $(LOWEST)
	$(LOWEST)/bin/python -m pip install --quiet uv
	$(LOWEST)/bin/uv pip install --quiet --python $(LOWEST)/bin/python --compile-bytecode --resolution lowest-direct --editable ".[full]"
	# import-linter alone asks for a newer one.
	$(LOWEST)/bin/uv pip install --quiet --python $(LOWEST)/bin/python "rich==13.7"
	$(LOWEST)/bin/pytest -n auto --dist worksteal --deselect tests/test_layout.py::test_imports_go_one_way_only $(FAST)

# Build wheel and source archive twice, check both, and run every command from the wheel in clean environments.
dist:
	$(PYTHON) -m venv --clear $(DIST)
	$(DIST)/bin/python -m pip install --quiet uv build twine check-wheel-contents
	$(DIST)/bin/python .ci/dist.py

# Count lines of code by room, without docstrings, comments and blank lines.
lines:
	$(PYTHON) .ci/lines.py plough_opt tests

# Mutation score: how many small changes of the code the tests detect. Takes about forty minutes on four idle cores.
mutants: $(READY)
	$(BIN)/python .ci/mutants.py --count 200

$(CORE): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet uv
	$(PIP) --editable .
	touch $@

$(READY): pyproject.toml | $(CORE)
	$(PIP) --compile-bytecode --editable ".[$(EXTRA)]"
	touch $@

$(DOCS): $(READY)
	$(PIP) --editable ".[docs]"
	touch $@

# The benchmarks skip peers that cannot be installed, and say which.
$(PEERS): $(READY)
	-$(PIP) --editable ".[bench]"
	touch $@

clean:
	rm -rf $(VENV) $(LOWEST) $(DIST) dist out
