# Every target makes its own environment when none is there. Arguments for the demo: make demo ARGS="--quick".
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SOURCES := $(shell find pisplit models controllers -name '*.py')
ARGS ?=

.PHONY: demo test lint bench docs gallery mutants clean

demo: $(VENV)/.package
	$(BIN)/python scripts/mpc_demo.py $(ARGS)

# A worker a core, with one BLAS thread each: several wait for one another.
test: lint
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/pytest -n auto --dist loadfile $(ARGS)

lint: $(VENV)/.package
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	cd tests && ../$(BIN)/mypy --config-file ../pyproject.toml --no-silence-site-packages -p pisplit
	$(BIN)/mypy scripts

bench: $(VENV)/.package
	$(BIN)/python scripts/benchmarks/benchmark.py $(ARGS)

# Pages and reference into out/docs/index.html, without network; what Sphinx warns of, broken links first, is an error.
docs: $(VENV)/.docs
	$(BIN)/python -m sphinx -W --keep-going -j auto -b html docs out/docs $(ARGS)

$(VENV)/.docs: $(VENV)/.package
	$(BIN)/pip install --quiet ".[docs]"
	$(BIN)/pip install --quiet --no-deps --no-build-isolation --force-reinstall .
	rm -rf build
	touch $@

gallery: $(VENV)/.package
	$(BIN)/python scripts/make_gallery.py $(ARGS)

# At most 30 minutes on two idle cores; goes on where it was stopped (docs/testing.md).
mutants: $(VENV)/.package
	$(BIN)/python scripts/mutants.py $(ARGS)

# The package is installed, not linked: tests and scripts see what a user's pip install gives.
$(VENV)/.package: $(VENV)/.dependencies $(SOURCES) README.md
	$(BIN)/pip install --quiet --no-deps --no-build-isolation --force-reinstall .
	rm -rf build
	touch $@

$(VENV)/.dependencies: pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --upgrade pip setuptools wheel
	$(BIN)/pip install --quiet ".[dev]"
	touch $@

clean:
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis out
