#!/bin/sh
# Makes .venv, or brings it up to date: interpreter, locked packages, then pkm_cnc_msgs and pkm_cnc built into it by
# colcon. Every step leaves a stamp with the fingerprint of what went in, and is skipped while that is unchanged.
#
#     tools/environment.sh [PYTHON]      PYTHON: the interpreter to use; without it, that of an existing .venv stays,
#                                        and a new one is made with python3
set -eu
cd "$(dirname "$0")/.."
top=$(pwd -P)
venv=$top/.venv
stamps=$venv/.stamps
asked=${1:-}
python=${asked:-python3}

say() { printf '== %s\n' "$*"; }
fail() {
  printf 'pkm_cnc: %s\n' "$*" >&2
  exit 1
}

# One line for the content and the names of all files under the given paths; what does not exist counts as empty.
fingerprint() {
  find "$@" -type f ! -name '*.py[co]' -print0 2>/dev/null | LC_ALL=C sort -z | xargs -0 sha256sum | sha256sum
}
stamp_is() { [ "$(cat "$stamps/$1" 2>/dev/null)" = "$2" ]; }
stamp() { printf '%s\n' "$2" >"$stamps/$1"; }

# --- what must be on the machine ---------------------------------------------------------------------------------
check_python() {
  case $python in */*) found=$python ;; *) found=$(command -v "$python") || found= ;; esac
  [ -n "$found" ] && [ -x "$found" ] ||
    fail "'$python' is missing: install Python 3.10 to 3.13, or name one: make ... PYTHON=python3.12"
  version=$("$python" -c 'import sys; print("%d %d" % sys.version_info[:2])' 2>/dev/null) ||
    fail "'$python' does not run: name a Python from 3.10 to 3.13: make ... PYTHON=python3.12"
  case $version in
    '3 10' | '3 11' | '3 12' | '3 13') ;;
    *) fail "'$python' is Python $(echo "$version" | tr ' ' .), needed is 3.10 to 3.13: make ... PYTHON=python3.12" ;;
  esac
  reason=$("$python" - <<'END'
import importlib.util, os, platform, struct, sys, sysconfig
package = "python%d.%d" % sys.version_info[:2]
if sys.implementation.name != "cpython" or sysconfig.get_config_var("Py_GIL_DISABLED"):
    print("is not the ordinary CPython, and the ROS packages are built for that alone")
elif struct.calcsize("P") != 8:
    print("is a 32-bit program, needed is a 64-bit one")
elif platform.libc_ver()[0] != "glibc":
    print("runs on another C library than glibc, and the ROS packages are built for glibc")
elif tuple(map(int, platform.libc_ver()[1].split(".")[:2])) < (2, 28):
    print("runs on glibc " + platform.libc_ver()[1] + ", needed is 2.28 or later")
elif not all(map(importlib.util.find_spec, ("venv", "ensurepip"))):
    print("lacks venv or ensurepip: install them (Debian, Ubuntu: apt install " + package + "-venv)")
elif not os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h")):
    print("lacks its header Python.h: install it (Debian, Ubuntu: apt install " + package + "-dev)")
END
  ) || fail "'$python' does not run: name a Python from 3.10 to 3.13: make ... PYTHON=python3.12"
  [ -z "$reason" ] || fail "'$python' $reason"
}

check_machine() {
  [ "$(uname -s)" = Linux ] || fail "this is $(uname -s), needed is Linux on x86-64"
  [ "$(uname -m)" = x86_64 ] || fail "this machine is $(uname -m), needed is x86-64 (the ROS packages are built for it)"
}

check_compiler() {
  command -v "${CC:-cc}" >/dev/null || command -v gcc >/dev/null || command -v clang >/dev/null ||
    fail "a C compiler is missing (Debian, Ubuntu: apt install build-essential)"
  command -v "${CXX:-c++}" >/dev/null || command -v g++ >/dev/null || command -v clang++ >/dev/null ||
    fail "a C++ compiler is missing (Debian, Ubuntu: apt install build-essential)"
  command -v make >/dev/null || fail "make is missing (Debian, Ubuntu: apt install make)"
  command -v cmake >/dev/null || fail "cmake is missing (Debian, Ubuntu: apt install cmake)"
  cmake=$(cmake --version 2>/dev/null | sed -n '1s/.* \([0-9][0-9]*\)\.\([0-9][0-9]*\).*/\1 \2/p')
  # shellcheck disable=SC2086  # two numbers
  set -- ${cmake:-0 0}
  [ "$1" -gt 3 ] || { [ "$1" -eq 3 ] && [ "$2" -ge 19 ]; } || fail "cmake is version $1.$2, needed is 3.19 or later"
}

# --- the steps ---------------------------------------------------------------------------------------------------
identity() { "$1" -c 'import os, sys; print(sys.version.split()[0], os.path.realpath(sys.base_prefix))'; }

make_interpreter() {
  made_with=$(sed -n 1p "$stamps/interpreter" 2>/dev/null) || made_with=
  if [ -n "$made_with" ] && [ "$(sed -n 2p "$stamps/interpreter")" = "$top" ] && "$venv/bin/python" -S -c '' 2>/dev/null
  then
    [ -n "$asked" ] || return 0
    check_python
    [ "$(identity "$python")" != "$made_with" ] || return 0
  fi
  check_machine
  check_python
  check_compiler
  say "environment: .venv with $("$python" --version)"
  rm -rf "$venv"
  output=$("$python" -m venv "$venv" 2>&1) || fail "'$python -m venv .venv' failed: $(echo "$output" | tail -n 1)"
  mkdir "$stamps"
  stamp interpreter "$(identity "$python")
$top"
}

# Runs pip with the arguments, its whole output in .venv/pip.log, and counts the packages.
counted_pip() {
  { "$venv/bin/python" -m pip --disable-pip-version-check --no-input install --progress-bar off "$@" 2>&1 || echo failed
  } | tee "$venv/pip.log" | awk -v total="$(grep -c == requirements.lock)" -v tty="$([ -t 1 ] && echo 1 || echo 0)" '
    /^(Collecting|Requirement already satisfied:)/ {
      name = $1 == "Collecting" ? $2 : $4
      sub(/[=<>!~;( ].*/, "", name)
      count++
      if (tty) printf "\r   %3d of %d %-50s", count, total, name
      else if (count % 20 == 0) printf "   %3d of %d\n", count, total
    }
    /^Installing collected packages/ { printf "%s   unpacking all of them (half a minute)\n", tty ? "\r" : "" }
    { fflush() }'
  [ "$(tail -n 1 "$venv/pip.log")" = failed ] || return 0
  # An index that cannot be reached looks to pip like one that has no version at all.
  missing=$(sed -n 's/^ERROR: .* requirement \([^ ]*\) .*from versions: none.*/\1/p' "$venv/pip.log")
  [ -z "$missing" ] || fail "the package index (PyPI) cannot be reached, or has no $missing (all of it: .venv/pip.log)"
  fail "pip failed: $(grep '^ERROR' "$venv/pip.log" | grep -v 'ERROR: Ignored' | sed -n 1p) (all of it: .venv/pip.log)"
}

install_packages() {
  wanted=$(fingerprint requirements.lock)
  ! stamp_is packages "$wanted" || return 0
  say "packages: those of requirements.lock (a minute or two)"
  rm -f "$stamps/packages"
  # The one source distribution among them is built by the locked setuptools, so nothing unlocked comes in.
  counted_pip -q "$(grep '^setuptools==' requirements.lock)"
  counted_pip --no-deps --no-build-isolation --requirement requirements.lock
  stamp packages "$wanted"
}

colcon_build() {
  # colcon takes a prefix without this file for a mistake and warns; it writes the real one itself.
  [ -e "$venv/local_setup.sh" ] || touch "$venv/local_setup.sh"
  # Neither a sourced ROS installation nor the user's colcon defaults nor the calling make may reach this build.
  env -u MAKEFLAGS -u MFLAGS -u MAKELEVEL -u CMAKE_PREFIX_PATH -u COLCON_PREFIX_PATH -u PYTHONPATH -u PYTHONHOME \
    -u PYTHONDONTWRITEBYTECODE \
    PATH="$venv/bin:$PATH" VIRTUAL_ENV="$venv" AMENT_PREFIX_PATH="$venv" COLCON_HOME="$venv/.colcon" \
    "$venv/bin/python" -m colcon --log-base "$venv/log" build --base-paths . pkm_cnc_msgs --packages-select "$@" \
    --merge-install --install-base "$venv" --build-base "$venv/build" --event-handlers desktop_notification- \
    --cmake-args -DCMAKE_BUILD_TYPE=Release -DBUILD_TESTING=OFF "-DCMAKE_PROJECT_INCLUDE=$top/tools/wheels.cmake" \
    "-DPython3_EXECUTABLE=$venv/bin/python" "-DPython3_ROOT_DIR=$venv" -DPython3_FIND_VIRTUALENV=ONLY
}

# The kernel takes no interpreter with a space in its path and none beyond 127 characters: such scripts start by sh.
make_scripts_startable() {
  case $venv in *' '*) ;; *) [ ${#venv} -gt 100 ] || return 0 ;; esac
  for script in "$venv"/lib/pkm_cnc/*; do
    { printf "#!/bin/sh\n'''exec' \"%s\" \"\$0\" \"\$@\"\n' '''\n" "$venv/bin/python"; sed 1d "$script"; } >"$script.new"
    chmod +x "$script.new"
    mv "$script.new" "$script"
  done
}

build_packages() {
  messages=$(fingerprint pkm_cnc_msgs tools/wheels.cmake requirements.lock)
  program=$(fingerprint setup.py setup.cfg package.xml resource pkm_cnc config launch programs requirements.lock)
  set --
  stamp_is pkm_cnc_msgs "$messages" || set -- pkm_cnc_msgs
  stamp_is pkm_cnc "$program" || set -- "$@" pkm_cnc
  [ $# -gt 0 ] || return 0
  check_compiler
  say "build: $*"
  for package in "$@"; do
    # What was deleted from the sources must not survive in the build or in the installation.
    rm -rf "$stamps/$package" "$venv/build/$package/build" "$venv/lib/$package" "$venv/share/$package" \
      "$venv"/lib/python3.*/site-packages/"$package"
  done
  rm -rf "$venv/log"
  colcon_build "$@" || fail "the build of $* failed (all of its output: .venv/log/latest_build)"
  make_scripts_startable
  ln -sf ../lib/pkm_cnc/pkm_cnc "$venv/bin/pkm_cnc"
  case $* in *pkm_cnc_msgs*) stamp pkm_cnc_msgs "$messages" ;; esac
  stamp pkm_cnc "$program"
}

# Two calls at once take turns.
if command -v flock >/dev/null; then
  exec 9<tools/environment.sh
  flock 9
fi
make_interpreter
install_packages
build_packages
