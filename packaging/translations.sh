#!/usr/bin/env bash
# Brings the texts of one translation up to date with the program, and makes of it what the program reads:
# bash packaging/translations.sh de
set -euo pipefail

repository=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)
cd -- "$repository"
language=${1:?"name the language, as in: bash packaging/translations.sh de"}
[[ $language =~ ^[a-z]{2,3}(_[A-Z]{2})?$ ]] || { printf '%s is not a language as in de or pt_BR\n' "$language" >&2; exit 2; }
[[ -x .venv/bin/pyside6-lupdate ]] || bash packaging/setup.sh

texts=resources/translations/caris_desktop_$language.ts
mkdir -p resources/translations
mapfile -t sources < <(find caris_desktop -name '*.py' | sort)
# The scenario editor labels its form with the texts of the schema, which no call of tr contains as a literal.
schema_texts=$(mktemp --suffix=.py)
trap 'rm -f -- "$schema_texts"' EXIT
PYTHONPATH=. .venv/bin/python packaging/scenario_texts.py "$schema_texts"
.venv/bin/pyside6-lupdate "${sources[@]}" "$schema_texts" -locations none -no-obsolete -target-language "$language" -ts "$texts"
.venv/bin/pyside6-lrelease "$texts" -qm "${texts%.ts}.qm"
