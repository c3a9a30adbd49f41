#!/bin/sh
# Resolves requirements.in into requirements.lock: the newest versions that the oldest Python has, checked to be a full
# and installable set on the others. Needs python3.10 to python3.13 and the network; installs nothing.
set -eu
export LC_ALL=C
cd "$(dirname "$0")/.."
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

resolve() { # PYTHON OUTPUT [pip's arguments]
  python=$1
  output=$2
  shift 2
  "$python" -m venv "$work/$python"
  "$work/$python/bin/pip" install -q --disable-pip-version-check --dry-run --ignore-installed --report "$work/report" \
    --requirement requirements.in "$@"
  "$python" - "$work/report" >"$output" <<'END'
import json, re, sys
installed = [item["metadata"] for item in json.load(open(sys.argv[1]))["install"]]
print("\n".join(sorted(re.sub(r"[-_.]+", "-", data["name"]).lower() + "==" + data["version"] for data in installed)))
END
}

echo '== python3.10 (decides)'
resolve python3.10 "$work/oldest"
cp "$work/oldest" "$work/everywhere"
for python in python3.11 python3.12 python3.13; do
  echo "== $python"
  resolve "$python" "$work/newer" --constraint "$work/oldest"
  new=$(comm -13 "$work/oldest" "$work/newer")
  [ -z "$new" ] || { echo "only on $python: $new; add them to requirements.in" >&2; exit 1; }
  comm -12 "$work/everywhere" "$work/newer" >"$work/both"
  mv "$work/both" "$work/everywhere"
done
{
  echo '# Exact versions of everything in .venv, for CPython 3.10 to 3.13 on x86-64 Linux. Written by `make lock` from'
  echo '# requirements.in.'
  while read -r line; do
    grep -qxF "$line" "$work/everywhere" && echo "$line" || echo "$line ; python_version < \"3.11\""
  done <"$work/oldest"
} >requirements.lock
