#!/usr/bin/env bash
# Sets everything up, test tools included, and runs the checks and the tests on a virtual screen.
#
#   bash packaging/test.sh                       the checks, and the tests that every change has to pass
#   bash packaging/test.sh --long                all tests, soak tests included: several hours
#   bash packaging/test.sh tests/robot -k lease  only pytest, with these arguments
set -euo pipefail

repository=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)
cd -- "$repository"
# The tests start this program some hundred times; compiling it again each time would take minutes.
unset PYTHONDONTWRITEBYTECODE
bash packaging/setup.sh --test

# Several times what the slowest of three runs takes on a slow machine.
longest_run=35m
long=()
if [[ $* == --long ]]; then
  long=(--long)
  longest_run=8h
  shift
fi

summary=()
failed=no
# keep NAME SECONDS STATUS: the outcome of a check for the summary.
keep() {
  if (($3 == 0)); then
    summary+=("$(printf '%-22s ok      %4d s' "$1" "$2")")
  else
    summary+=("$(printf '%-22s FAILED  %4d s  (exit %d)' "$1" "$2" "$3")")
    failed=yes
  fi
}
# check NAME COMMAND...: runs it and saves its outcome.
check() {
  local name=$1 started=$SECONDS status=0
  shift
  printf '\n== %s\n' "$name"
  "$@" || status=$?
  keep "$name" $((SECONDS - started)) "$status"
}
find_tests() {
  local found
  found=$(.venv/bin/python -m pytest --collect-only -qq 2>&1) || { printf '%s\n' "$found"; return 1; }
}

if (($# == 0)); then
  check "lint (ruff)" .venv/bin/ruff check .
  check "format (ruff)" .venv/bin/ruff format --check .
  # It occupies a core for a minute or two; tests that do not measure time can run meanwhile.
  of_types=$(mktemp)
  .venv/bin/mypy >"$of_types" 2>&1 &
  types=$!
  # Each of several workers would compile again what all of them import; after a first run, most of it is there.
  compgen -G "tests/__pycache__/conftest.*-pytest-*.pyc" >/dev/null || check "tests are found" find_tests
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
# then is listed in the summary as flaky, and has to be looked at.
run_tests() {
  local -a first
  local status=0
  rm -f -- "$failures"
  # Files in the order of tests/conftest.py, which knows the long ones; xdist would start with those of most tests.
  # A run that hangs is stopped as by Ctrl+C, which names what was running.
  timeout --foreground --signal INT --kill-after 60 "$longest_run" \
    .venv/bin/python -m pytest --dist loadfile --no-loadscope-reorder --durations 25 "${long[@]}" "$@" || status=$?
  # 1 means that tests failed; anything else is no verdict on them, and is not mended by another try.
  ((status == 1)) || return "$status"
  mapfile -t first < <(failed_tests)
  printf '\n== failed tests, again and alone\n'
  .venv/bin/python -m pytest -n 0 --last-failed --last-failed-no-failures none -m "" "${long[@]}" || return
  unsteady+=("${first[@]}")
}

if (($# == 0)); then
  # They wait for processes and timers for a third of their time.
  check "tests, packages" run_tests -n 4 -m "not alone" --ignore tests/app tests
  started=$SECONDS status=0
  printf '\n== types (mypy)\n'
  wait "$types" || status=$?
  cat -- "$of_types"
  rm -f -- "$of_types"
  keep "types (mypy)" $((SECONDS - started)) "$status"
  # Those of the whole program start a dozen processes each.
  check "tests, whole program" run_tests -n 2 -m "not alone" tests/app
  mapfile -t of_real_time < <(grep -rl --include='test_*.py' 'pytest.mark.alone' tests)
  check "tests of real time" run_tests -n 2 -m alone "${of_real_time[@]}"
else
  check "tests (pytest)" .venv/bin/python -m pytest "$@"
fi

printf '\n== summary\n'
printf '%s\n' "${summary[@]}"
if ((${#unsteady[@]})); then
  printf '\nflaky, as they passed only when run again and alone:\n'
  printf '  %s\n' "${unsteady[@]}"
fi
[[ $failed == no ]]
