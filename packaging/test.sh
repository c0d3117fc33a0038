#!/usr/bin/env bash
# Sets everything up, test tools included, and runs the checks and the tests on a virtual screen.
# With arguments only pytest runs, with these arguments: bash packaging/test.sh tests/robot -k lease
set -euo pipefail

repository=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)
cd -- "$repository"
# The tests start this program some hundred times; compiled anew each time it would cost minutes.
unset PYTHONDONTWRITEBYTECODE
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

unsteady=()
failures=.pytest_cache/v/cache/lastfailed
failed_tests() { .venv/bin/python -c 'import json, sys; print(*json.load(open(sys.argv[1])), sep="\n")' "$failures"; }

# run_tests ARGUMENTS...: what fails is tried once more, alone, as tests of real processes share a busy machine. What passes
# then is named in the summary: it is unsteady, and somebody should look at it.
run_tests() {
  local -a first
  local status=0
  rm -f -- "$failures"
  .venv/bin/python -m pytest --durations 25 "$@" || status=$?
  # 1 means that tests failed; anything else is no verdict on them, and is not mended by another try.
  ((status == 1)) || return "$status"
  mapfile -t first < <(failed_tests)
  printf '\n== what failed, again and alone\n'
  .venv/bin/python -m pytest -n 0 --last-failed --last-failed-no-failures none -m "" || return
  unsteady+=("${first[@]}")
}

if (($# == 0)); then
  # Tests wait more than they compute. Those of the whole program start a dozen processes each, so two files run at a
  # time; of the others four.
  check "tests, whole program" run_tests -n 2 --dist loadfile -m "not alone" tests/app
  check "tests, other rooms" run_tests -n 4 --dist loadfile -m "not alone" --ignore tests/app tests
  check "tests of real time" run_tests -n 2 --dist loadfile -m alone
else
  check "tests (pytest)" .venv/bin/python -m pytest "$@"
fi

printf '\n== summary\n'
printf '%s\n' "${summary[@]}"
if ((${#unsteady[@]})); then
  printf '\nunsteady, as they passed only when tried again and alone:\n'
  printf '  %s\n' "${unsteady[@]}"
fi
[[ $failed == no ]]
