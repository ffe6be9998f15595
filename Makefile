# make help lists the targets. Set-up is part of each: nothing has to be installed by hand on Debian or Ubuntu.
.DEFAULT_GOAL := help
.PHONY: help demo test fuzz constraints lint bench paper docs samples clean
BIN := .venv/bin
PYTEST_WORKERS ?= 2
FUZZ_SECONDS ?= 600

help:  ## List the targets
	@grep -E '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

demo:  ## Install what is needed and reconstruct a sample shape
	@bash tools/bootstrap.sh cpu
	@$(BIN)/python pipelines/demo.py --output output/demo

test:  ## Run the tests
	@bash tools/bootstrap.sh cpu,dev,docs,formats,cad
	@OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(PYTEST_WORKERS) --dist loadfile -q

fuzz:  ## Explore the property tests with fresh seeds, for FUZZ_SECONDS and the end of the round
	@bash tools/bootstrap.sh cpu,dev,docs,formats,cad
	@end=$$(($$(date +%s) + $(FUZZ_SECONDS))); while [ $$(date +%s) -lt $$end ]; do \
	    OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(PYTEST_WORKERS) --dist loadfile -q -m hypothesis \
	        --hypothesis-profile fuzz --seed $$(date +%s) || exit; done

lint:  ## Check style and types
	@bash tools/bootstrap.sh cpu,dev
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy

bench:  ## Measure accuracy and speed beside peers (minutes)
	@bash tools/bootstrap.sh cpu,bench
	@$(BIN)/python -m benchmarks --output output/bench

paper:  ## Repeat the paper's figures and tables, quickly, in output/paper
	@bash tools/bootstrap.sh cpu,bench
	@for script in grids weights unit_sphere round_trip; do $(BIN)/python pipelines/paper/$$script.py || exit; done
	@$(BIN)/python pipelines/paper/star_shapes.py
	@$(BIN)/python pipelines/paper/star_shapes.py --clouds
	@$(BIN)/python pipelines/paper/retrieval.py --cpshd

docs:  ## Build the documentation site in output/site
	@bash tools/bootstrap.sh cpu,docs
	@$(BIN)/python -m sphinx -W --keep-going -q -d output/doctrees docs output/site
	@echo "Open output/site/index.html"

constraints:  ## Write constraints.txt anew with the newest versions; takes Python 3.10 to 3.13
	@bash tools/bootstrap.sh cpu
	@$(BIN)/python tools/constraints.py

samples:  ## Generate the sample shapes anew
	@bash tools/bootstrap.sh cpu,formats
	@$(BIN)/python samples/generate.py

clean:  ## Remove the environment and everything generated
	rm -rf .venv output build dist .mypy_cache .ruff_cache .pytest_cache
