# `make run` and `make test` do all the set-up themselves; they need Python 3.11 or newer and make.
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
READY  := $(VENV)/.plough_opt-installed
PEERS  := $(VENV)/.peers-installed

.PHONY: run test slow bench clean

run: $(READY)
	$(BIN)/plough-opt optimise problems/cotton_subsoiler.toml --plot out/cotton_subsoiler.png

test: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/pytest -n auto --dist worksteal

slow: $(READY)
	$(BIN)/pytest -n auto --dist worksteal -m "slow or not bench"

bench: $(PEERS)
	$(BIN)/pytest -m bench tests/benchmarks --benchmark-columns=min,median,iqr,rounds --benchmark-sort=name

$(READY): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --editable ".[test]"
	touch $@

# Where a peer cannot be installed the benchmarks leave it out, and say so.
$(PEERS): $(READY)
	-$(BIN)/python -m pip install --quiet --editable ".[bench]"
	touch $@

clean:
	rm -rf $(VENV) out
