# Everything a clone needs; `make help` lists it. Each target sets up what it needs first.

PYTHON ?= python3
DEMO_INPUT ?= data/street_colmap
DEMO_OUTPUT ?= out/demo
DEMO_REFERENCE ?= $(DEMO_INPUT)_ground_truth
# 1 % of the demo's observations are gross outliers, which a least-squares fit alone would follow.
DEMO_LOSS ?= --loss cauchy
DEMO_OPTIONS ?= --rounds 3

# Tests start hundreds of processes; without cached bytecode each would compile the package again.
unexport PYTHONDONTWRITEBYTECODE

VENV := .venv
READY := $(VENV)/ready
READY_TO_RUN := $(VENV)/ready-to-run
READY_TO_BENCH := $(VENV)/ready-to-bench
READY_TO_DOCUMENT := $(VENV)/ready-to-document
BUILT_FROM := pyproject.toml CMakeLists.txt $(shell find cpp -type f) tools/setup.sh
CPP_SOURCES = $(shell find cpp python/bundle examples tests -name '*.h' -o -name '*.cpp')
# Where pip builds the module (pyproject.toml); the C++ tests share its objects.
BUILD := build/release
SANITIZED := MAKEFLAGS= PATH="$(CURDIR)/$(VENV)/bin:$$PATH" bash tools/build_sanitized.sh
ADDRESS_BUILD := build/sanitize
THREAD_BUILD := build/thread
# Runs a GoogleTest program once per core, each with its share of the tests.
SHARDED = seq 0 $$(($$(nproc) - 1)) | UBSAN_OPTIONS=print_stacktrace=1 \
  TSAN_OPTIONS=suppressions=$(CURDIR)/tools/tsan_suppressions.txt GTEST_TOTAL_SHARDS=$$(nproc) \
  xargs -P 0 -I {} env GTEST_SHARD_INDEX={}

.DEFAULT_GOAL := help
.PHONY: help setup demo test sanitize tsan lint lint-python lint-cpp format docs quotes bench bench-gate clean

help:  ## list the targets
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/make \1\t\2/p' $(MAKEFILE_LIST) | expand -t 14

setup: $(READY)  ## install what is missing, build the C++ core, fill .venv (PYTHON=python3.13 to choose one)

# The first refinement waits for no tool of the tests: those take a minute to fetch.
$(READY_TO_RUN): $(BUILT_FROM)
	bash tools/setup.sh $(PYTHON) $(VENV)
	@touch $@

$(READY): $(BUILT_FROM)
	bash tools/setup.sh $(PYTHON) $(VENV) test,lint
	@touch $(READY_TO_RUN) $@

$(READY_TO_BENCH): $(READY)
	bash tools/setup.sh $(PYTHON) $(VENV) test,lint,bench
	@touch $@

$(READY_TO_DOCUMENT): $(READY)
	$(VENV)/bin/python -c 'import tomllib; project = tomllib.load(open("pyproject.toml", "rb"))["project"]; \
	  print(*project["optional-dependencies"]["docs"], sep="\n")' | \
	  $(VENV)/bin/python -m pip install --quiet --no-compile --requirement /dev/stdin
	@touch $@

demo: $(READY_TO_RUN)  ## refine the model in data/ and compare it with the truth
	@mkdir -p $(dir $(DEMO_OUTPUT))
	$(VENV)/bin/bundle refine $(DEMO_INPUT) -o $(DEMO_OUTPUT) $(DEMO_LOSS) $(DEMO_OPTIONS)
	test ! -e $(DEMO_REFERENCE) || \
	  $(VENV)/bin/bundle evaluate $(DEMO_OUTPUT) --reference $(DEMO_REFERENCE) $(DEMO_LOSS)

test: $(READY)  ## run the tests
	$(VENV)/bin/python -m pytest --numprocesses auto --dist worksteal

sanitize: $(READY_TO_RUN)  ## run the C++ tests under AddressSanitizer and UndefinedBehaviorSanitizer
	rm -f $(ADDRESS_BUILD)/passed
	$(SANITIZED) g++ address,undefined,float-cast-overflow $(ADDRESS_BUILD)
	$(SHARDED) $(ADDRESS_BUILD)/tests/cpp/bundle_tests --gtest_brief=1
	$(SHARDED) BUNDLE_INSTRUCTION_SET=baseline $(ADDRESS_BUILD)/tests/cpp/bundle_tests \
	  --gtest_brief=1 --gtest_filter='*Schur*:*Fused*:*Panel*'
	@touch $(ADDRESS_BUILD)/passed

tsan: $(READY_TO_RUN)  ## run the C++ tests under ThreadSanitizer
	$(SANITIZED) clang++ thread $(THREAD_BUILD)
	$(SHARDED) $(THREAD_BUILD)/tests/cpp/bundle_tests --gtest_brief=1

lint: lint-python lint-cpp  ## check format, style, types and compiler warnings (of C++ tests: make sanitize)

lint-python: $(READY)
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	$(VENV)/bin/python -m mypy.stubtest bundle._core --ignore-disjoint-bases --allowlist tools/stubtest_allowlist.txt

lint-cpp: $(READY)
	$(VENV)/bin/clang-format --dry-run -Werror $(CPP_SOURCES)
	PATH="$(CURDIR)/$(VENV)/bin:$$PATH" cmake -S . -B $(BUILD) --log-level=WARNING \
	  -DBUNDLE_WARNINGS_AS_ERRORS=ON
	MAKEFLAGS= PATH="$(CURDIR)/$(VENV)/bin:$$PATH" cmake --build $(BUILD) --target all

format: $(READY)  ## rewrite the sources in the house format
	$(VENV)/bin/ruff check --fix-only .
	$(VENV)/bin/ruff format .
	$(VENV)/bin/clang-format -i $(CPP_SOURCES)

docs: $(READY_TO_DOCUMENT)  ## build the documentation, build/site/index.html, and manual pages; a warning is an error
	$(VENV)/bin/python tools/man_pages.py
	$(VENV)/bin/python -m sphinx --quiet --fail-on-warning --keep-going \
	  -c tools/site -d build/doctrees docs build/site
	@echo "build/site/index.html"

quotes: $(READY)  ## rewrite what documents quote from the code
	$(VENV)/bin/python tools/camera_table.py --update
	$(VENV)/bin/python tools/quoted_outputs.py --update
	$(VENV)/bin/python tools/json_schema.py
	$(VENV)/bin/python tools/readme_picture.py
	$(VENV)/bin/python tools/page_picture.py

bench: $(READY_TO_BENCH)  ## measure against the peers, real data and synthetic (half an hour; writes benchmarks/results)
	$(VENV)/bin/python benchmarks/run.py

bench-gate: $(READY_TO_BENCH)  ## compare the lead over pycolmap with that of the last release (two minutes)
	$(VENV)/bin/python -m benchmarks.gate

clean:  ## remove all that make made, but for benchmarks/results
	rm -rf $(VENV) build out .pytest_cache .mypy_cache .ruff_cache
	find python tests benchmarks examples -name __pycache__ -prune -exec rm -rf {} +
