# `make demo` and `make test` do all their own set-up on a fresh clone. PYTHON must be 3.11 or 3.12.
SHELL := /bin/bash
PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed
# A software Vulkan device made by `make renderer` is used by every target below.
ICD := $(wildcard .vulkan/swiftshader_icd.json)
ifneq ($(ICD),)
export VK_ICD_FILENAMES ?= $(abspath $(ICD))
endif

.PHONY: setup demo train paper test test-slow test-gpu check docs bench renderer clean

setup: $(STAMP)

# torch first and by its pinned version, so that nothing asks for another one (constraints.txt).
$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet -c constraints.txt torch==$$(sed -n 's/^torch==//p' constraints.txt)
	$(BIN)/pip install --quiet -c constraints.txt -e '.[dev]'
	mkdir -p build
	# Numba compiles here, on two cores, so that the first command moves at once.
	$(BIN)/python -W ignore -c "from modpush.planners import warmup; warmup()" & \
	$(BIN)/python -W ignore -c "import modpush as m; a = m.load_agent('pose'); a.make_env(2).rollout(2, a.policy)" && \
	$(BIN)/modpush demo --episodes 1 --scenes free --no-rendered --out build/demo > build/demo.txt && wait $$!
	touch $@

train: setup
	$(BIN)/modpush train cpu --out runs/train
	$(BIN)/modpush train refine --init-from runs/train --out runs/refine

demo: setup
	$(BIN)/modpush demo

# The paper's tables, pictures and times: hours; an interrupted run continues (docs/howto/reproduce.md).
paper: setup
	$(BIN)/python -m paper run --workers 2
	for part in rows tables examples runtime dynamics; do $(BIN)/python -m paper $$part || exit 1; done

# A process for each core, up to four; one that is done takes over half of another's tests.
test: setup
	$(BIN)/python -m pytest -n logical --maxprocesses 4 --dist worksteal

test-slow: setup
	$(BIN)/python -m pytest -m slow -s

# What has never run on a GPU: the batched simulation, CUDA graphs, training on CUDA. Send build/gpu_report.txt.
test-gpu: setup
	mkdir -p build
	$(BIN)/python -m torch.utils.collect_env > build/gpu_report.txt
	git rev-parse HEAD >> build/gpu_report.txt
	set -o pipefail; $(BIN)/python -m pytest -m gpu -rA --durations=0 2>&1 | tee -a build/gpu_report.txt

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# Strictly: a broken link or reference, or a notebook that fails, ends it. DOCS_EXECUTE=false runs no notebook.
docs: setup
	$(BIN)/mkdocs build --strict

bench: setup
	$(BIN)/pip install --quiet -c constraints.txt -e '.[bench]'
	for file in benchmarks/bench_*.py; do $(BIN)/python $$file || exit 1; done

renderer:
	bash tools/software_vulkan.sh

clean:
	rm -rf .venv .vulkan build runs
