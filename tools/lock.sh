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
for minor in 11 12 13; do
  echo "== python3.$minor"
  resolve "python3.$minor" "$work/3.$minor" --constraint "$work/oldest"
  new=$(comm -13 "$work/oldest" "$work/3.$minor")
  [ -z "$new" ] || { echo "only on python3.$minor: $new; add them to requirements.in" >&2; exit 1; }
done
{
  echo '# Exact versions of everything in .venv, for CPython 3.10 to 3.13 on x86-64 Linux. Written by `make lock` from'
  echo '# requirements.in.'
  while read -r line; do
    marker=
    for minor in 13 12 11; do # a package that a newer Python does without is needed below it
      grep -qxF "$line" "$work/3.$minor" && break
      marker=" ; python_version < \"3.$minor\""
    done
    echo "$line$marker"
  done <"$work/oldest"
} >requirements.lock
