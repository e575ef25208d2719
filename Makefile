# `make demo` and `make test` do everything on a fresh machine; `make help` lists the rest.
SHELL := /bin/bash
.DEFAULT_GOAL := help
.PHONY: help setup demo test lint bench thesis lock clean

help:  ## list the targets
	@sed -n 's/^\([a-z]*\):.*## */  make \1\t/p' $(MAKEFILE_LIST) | expand -t 16

setup:  ## make .venv, build the workspace into install/ and write ./tissue
	@PYTHON="$(PYTHON)" bash scripts/setup.sh

demo: setup  ## a scripted operation on the heart; results in out/demo/
	@./tissue demo $(ARGS)

test: setup  ## lint, types and all tests; ARGS="test/unit -k cut" runs some
	@bash scripts/test.sh $(ARGS)

lint: setup  ## lint and types alone
	@bash scripts/lint.sh

bench: setup  ## steps a second of every model; results in out/bench.json
	@./tissue bench $(ARGS)

thesis: setup  ## the thesis' comparison of models, its tables beside ours; results in out/
	@./tissue thesis $(ARGS)

lock: setup  ## choose package versions anew: requirements*.in -> requirements/*.lock
	@bash scripts/lock.sh

clean:  ## remove everything that was made
	rm -rf .venv build install log out tissue .setup.lock .mypy_cache .pytest_cache .ruff_cache .hypothesis
