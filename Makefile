# Every target is a task of run.py; `python run.py TASK` does the same where there is no make.
PYTHON ?= python3
ARGS ?=
TASKS := help setup test test-long test-energy test-web test-fleet test-load test-compose demo bench study test-recommend references convergence contact-sheet lint types walls wheels screenshots secret clean

.PHONY: $(TASKS)
.DEFAULT_GOAL := help
$(TASKS):
	@$(PYTHON) run.py $@ $(ARGS)
