#!/usr/bin/env bash
# Sets everything up, test tools included, and runs the checks and the tests on a virtual screen.
# With arguments only pytest runs, with these arguments: bash packaging/test.sh tests/robot -k lease
set -euo pipefail

repository=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)
cd -- "$repository"
bash packaging/setup.sh --test

summary=()
failed=no
# check NAME COMMAND...: runs it and keeps its outcome for the summary.
check() {
  local name=$1 started=$SECONDS status=0
  shift
  printf '\n== %s\n' "$name"
  "$@" || status=$?
  if ((status == 0)); then
    summary+=("$(printf '%-22s ok      %4d s' "$name" $((SECONDS - started)))")
  else
    summary+=("$(printf '%-22s FAILED  %4d s  (exit %d)' "$name" $((SECONDS - started)) "$status")")
    failed=yes
  fi
}

if (($# == 0)); then
  check "lint (ruff)" .venv/bin/ruff check .
  check "format (ruff)" .venv/bin/ruff format --check .
  check "types (mypy)" .venv/bin/mypy
  check "rooms (import-linter)" .venv/bin/lint-imports
fi

if [[ $(uname -s) == Linux ]]; then
  # shellcheck source=packaging/virtual_screen.sh
  source packaging/virtual_screen.sh
  start_virtual_screen
fi

# Tests wait more than they compute, so two files run at a time, in the order of the alphabet: those of the whole program
# come first and take longest. Whatever fails that way must pass alone: tests of real processes share the processor with
# others.
two_at_a_time() {
  .venv/bin/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder -m "not alone" && return
  printf '\n== what failed, again and alone\n'
  .venv/bin/python -m pytest -m "not alone" --last-failed --last-failed-no-failures none
}

if (($# == 0)); then
  check "tests, two at a time" two_at_a_time
  check "tests of real time" .venv/bin/python -m pytest -m alone
else
  check "tests (pytest)" .venv/bin/python -m pytest "$@"
fi

printf '\n== summary\n'
printf '%s\n' "${summary[@]}"
[[ $failed == no ]]
