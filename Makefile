# Two commands do all set-up: `make demo` and `make test`. `make check` is what CI runs beside the tests.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Two workers with one thread each, as the server's own children have; more threads would only compete.
TWO_WORKERS := OPENBLAS_NUM_THREADS=1 OPENCV_FOR_THREADS_NUM=1 $(BIN)/pytest -n 2 --dist loadfile --no-loadscope-reorder
RECORD := $(or $(COVERAGE),$(VENV)/record)
unexport PYTHONDONTWRITEBYTECODE  # else every process compiles the app, and pytest rewrites every test, anew

.PHONY: venv dev lock audit demo browse test test-share test-all test-times docs bench check format serve clean

venv: $(VENV)/.runtime  ## the virtual environment .venv with what the program needs, nothing else

$(VENV)/.runtime: pyproject.toml tools/lock/build.txt tools/lock/runtime.txt
	@echo "== setting up $(VENV) (first time: a minute)"
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "tada-server needs Python 3.11 or newer: make PYTHON=python3.11 ...")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --require-hashes --requirement tools/lock/build.txt --requirement tools/lock/runtime.txt
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --editable .
	@touch $@

dev: $(VENV)/.dev  ## what tests and checks need, too

$(VENV)/.dev: $(VENV)/.runtime tools/lock/dev.txt
	@echo "== adding what tests and checks need (first time: a minute or two)"
	$(BIN)/python -m pip install --quiet --require-hashes --requirement tools/lock/dev.txt
	@touch $@

LOCK := $(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-annotate --no-header \
	--no-emit-index-url $(UPGRADE)

lock: dev  ## tools/lock for what pyproject.toml asks, with the hashes of all files; UPGRADE=--upgrade: the newest of all others
	$(BIN)/python -m pip install --quiet uv==0.13.9
	$(LOCK) tools/lock/build.in --output-file tools/lock/build.txt
	$(LOCK) pyproject.toml tools/lock/build.in --extra dev --constraint tools/lock/build.txt --output-file tools/lock/dev.txt
	$(LOCK) pyproject.toml --constraint tools/lock/dev.txt --output-file tools/lock/runtime.txt

audit: dev  ## known faults of the locked packages, where a list of them can be reached
	$(BIN)/python tools/audit_packages.py

demo: venv  ## one meal, from upload to record, on throwaway data
	$(BIN)/tada demo

browse: venv  ## a sample study to look at in a browser, on throwaway data, until Ctrl-C
	$(BIN)/tada demo --browse

test: dev  ## the gate, by which a change is judged: some six minutes on two quiet cores
	$(TWO_WORKERS) -m "not slow"

test-share: dev  ## the gate and one sixth of the other tests, TADA_TEST_SHARE=0 to 5: 8 to 13 minutes
	$(TWO_WORKERS)

test-all: dev  ## every test
	$(TWO_WORKERS)

test-times: dev  ## every test, and docs/tests.md made anew; COVERAGE=FOLDER: which tests run which lines, too, which is slower
	mkdir -p $(RECORD)
	start=$$(date +%s); $(TWO_WORKERS) -p tools.record_tests --record-times=$(RECORD)/times.jsonl \
		$(if $(COVERAGE),--record-coverage=$(COVERAGE)); result=$$?; \
	$(BIN)/python tools/test_times.py $(RECORD)/times.jsonl $$(($$(date +%s) - start)) && exit $$result

docs: dev  ## every page of docs/ rendered as under /docs/guide; a link to nothing is an error
	$(BIN)/pytest -q tests/unit/docs tests/integration/dashboard/test_guide.py

bench: dev  ## the short form of all benchmarks, against the last release's figures: docs/performance.md; ten minutes
	$(BIN)/python -m benchmarks.bench

benchmark-real: dev  ## volumes of real photographs against measured ones, by the coin in them; three minutes
	$(BIN)/python benchmarks/weighed_photographs.py

check: dev  ## lint, format, types, import rule
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python tools/check_private_names.py

format: dev
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

serve: venv  ## a server with its worker on ./data
	$(BIN)/tada serve

clean:
	rm -rf $(VENV) dist build .mypy_cache .ruff_cache .pytest_cache .import_linter_cache
