#!/usr/bin/env bash
# Resolve setup/requirements.in into setup/requirements.lock, one file for every supported Python.
# Needs uv (pip install uv); set-up itself needs plain pip only.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")"
resolved=$(uv pip compile --config-file uv.toml --python-version 3.11 --universal \
  --no-header --no-annotate --quiet "$@" requirements.in)
{
  echo "# Made by setup/lock.sh from setup/requirements.in. Install with: pip install --no-deps -r"
  grep -v "sys_platform == 'win32'\|sys_platform == 'emscripten'" <<<"$resolved"
} >requirements.lock
