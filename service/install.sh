#!/usr/bin/env bash
# Installs spheremouse on Debian, Ubuntu and Raspberry Pi OS, or another version of it beside the one that is there:
#     sudo bash service/install.sh
# A virtual environment per version under /opt/spheremouse, `current` leads to the one in use, and the service runs from
# there. A version that does not come up is switched back. See --help.
set -euo pipefail

here=$(cd "$(dirname "$0")" && pwd)
prefix=/opt/spheremouse
bin=/usr/local/bin
wheelhouse=
from=
build=
extras=
action=install
purge=
service=yes
patience=${SPHEREMOUSE_PATIENCE:-300} # s that a version may take to come up: the first start compiles
python=${PYTHON:-python3}

usage() {
    cat <<END
usage: install.sh [options]
  (none)                install, or upgrade, from the checkout this script is in (or the wheels beside it)
  --from WHAT           another checkout or wheel
  --wheelhouse DIR      without network: all wheels are in DIR
  --build-wheelhouse DIR  fill DIR with all wheels and this script, for machines without network of the same kind
  --extras A,B          optional parts, such as plot
  --rollback            switch back to the version before
  --uninstall           stop and remove the service and all versions; --purge: configuration and calibration, too
  --prefix DIR          where versions go, in place of /opt/spheremouse
  --bin DIR             where the command goes, in place of /usr/local/bin
  --no-service          the program only
END
}
say() { echo "install.sh: $*"; }
fail() {
    echo "install.sh: $*" >&2
    exit 1
}
while [ $# -gt 0 ]; do
    case $1 in
    --from | --wheelhouse | --build-wheelhouse | --extras | --prefix | --bin)
        [ $# -ge 2 ] || fail "$1 needs a value; see --help"
        case $1 in
        --from) from=$2 ;;
        --wheelhouse) wheelhouse=$2 ;;
        --build-wheelhouse) build=$2 ;;
        --extras) extras=$2 ;;
        --prefix) prefix=$2 ;;
        --bin) bin=$2 ;;
        esac
        shift
        ;;
    --rollback) action=rollback ;;
    --uninstall) action=uninstall ;;
    --purge) purge=--purge ;;
    --no-service) service= ;;
    -h | --help)
        usage
        exit 0
        ;;
    *) fail "$1: unknown; see --help" ;;
    esac
    shift
done

# ---- what the system must have ----

check_python() {
    command -v "$python" >/dev/null || fail "there is no $python; on Debian: apt-get install python3"
    "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || fail "spheremouse needs Python 3.11 or newer," \
        "$python is $("$python" -V): take Debian 12, Ubuntu 24.04, Raspberry Pi OS 12 or newer, or PYTHON=/path install.sh"
}

# A Python that makes virtual environments, and what evdev, which comes as source, is compiled with.
system_packages() {
    local missing=() name=python3
    [ "$(command -v "$python")" = /usr/bin/python3 ] || [ "$python" = python3 ] || name=$(basename "$python")
    "$python" -c 'import venv, ensurepip' 2>/dev/null || missing+=("$name-venv")
    command -v cc >/dev/null || missing+=(gcc libc6-dev)
    [ -e /usr/include/linux/uinput.h ] || missing+=(linux-libc-dev)
    [ -e "$("$python" -c 'import sysconfig; print(sysconfig.get_path("include"))')/Python.h" ] || missing+=("$name-dev")
    [ "${#missing[@]}" != 0 ] || return 0
    command -v apt-get >/dev/null || fail "missing: what Debian calls ${missing[*]}; install that and repeat"
    [ "$(id -u)" = 0 ] || fail "missing: ${missing[*]}; run: sudo apt-get install ${missing[*]}"
    say "apt-get installs ${missing[*]}"
    apt-get -qq -o DPkg::Lock::Timeout=300 update
    DEBIAN_FRONTEND=noninteractive apt-get -qq -o DPkg::Lock::Timeout=300 install -y --no-install-recommends \
        "${missing[@]}" >/dev/null || fail "apt-get could not install ${missing[*]}"
}

kind() { "$python" -c 'import sys, platform; print(f"Python {sys.version_info[0]}.{sys.version_info[1]}, {platform.machine()}")'; }

# ---- versions ----

# What in the prefix is ours: folders with a virtual environment that has the program.
versions() {
    local path
    for path in "$prefix"/*; do
        if [ ! -L "$path" ] && [ -e "$path/pyvenv.cfg" ] && [ -e "$path/bin/spheremouse" ]; then basename "$path"; fi
    done
}
# in_use NAME: the folder that the link NAME (current or previous) leads to, or nothing
in_use() { if [ -L "$prefix/$1" ]; then basename "$(readlink "$prefix/$1")"; fi; }
point() { # point LINK TARGET: at any moment there is the old link or the new one
    ln -sfn "$2" "$1.new"
    mv -Tf "$1.new" "$1"
}
systemd_runs() { [ -n "$service" ] && [ -d /run/systemd/system ]; }
program() { printf %s "$prefix/current/bin/spheremouse"; }

# Does the service answer? What was not started (no rig yet) need not.
healthy() {
    systemd_runs || return 0
    local until=$((SECONDS + patience))
    if ! systemctl is-enabled -q spheremouse.service || [ ! -e /etc/spheremouse/rig.yaml ]; then
        say "not started: there is no calibrated device yet (/etc/spheremouse/rig.yaml), or it is disabled"
        return 0
    fi
    timeout "$patience" systemctl restart spheremouse.service || true # returns when it is ready, or did not get so far
    until [ "$(systemctl is-active spheremouse.service)" = active ] &&
        timeout 20 "$(program)" ctl status >/dev/null 2>&1; do
        if [ $SECONDS -ge $until ]; then return 1; fi
        sleep 2
    done
    sleep 3 # one that comes up and falls is not healthy
    [ "$(systemctl is-active spheremouse.service)" = active ] && timeout 20 "$(program)" ctl status
}

# Make a version the one in use; its files of the service in place of the others'.
switch() { # switch NAME
    point "$prefix/current" "$1"
    [ -z "$service" ] || "$(program)" service install --no-start
}

# Compile beforehand as the service's user, into its cache, while the version before still runs.
warm() {
    [ -n "$service" ] && id spheremouse >/dev/null 2>&1 && [ -d /var/cache/spheremouse ] || return 0
    command -v runuser >/dev/null || return 0
    say "compiling for this machine, a minute or more"
    (cd / && runuser -u spheremouse -- env NUMBA_CACHE_DIR=/var/cache/spheremouse "$prefix/$1/bin/python" -m spheremouse.warm) ||
        say "compiling beforehand did not work; the first start will do it"
}

back_to() { # back_to NAME
    say "switching back to $1"
    switch "$1" || say "the service's files of $1 could not be placed: $(program) service install"
    healthy || fail "$1 does not come up either; see: journalctl -u spheremouse"
    say "$1 is in use again"
}

# ---- actions ----

build_wheelhouse() {
    check_python
    system_packages
    mkdir -p "$build"
    made=$(mktemp -d)
    trap 'rm -rf "$made"' EXIT
    "$python" -m venv "$made/venv"
    "$made/venv/bin/pip" -q wheel -w "$build" "$(source_of)${extras:+[$extras]}" pip
    cp "$here/install.sh" "$build/"
    kind >"$build/BUILT-FOR"
    say "$build: $(find "$build" -name '*.whl' | wc -l) wheels, $(du -sh "$build" | cut -f1), for $(kind)"
    say "carry it to the other machine, then there: sudo bash $(basename "$build")/install.sh"
}

source_of() {
    if [ -n "$from" ]; then
        realpath "$from"
    elif [ -e "$here/../pyproject.toml" ]; then
        realpath "$here/.."
    else
        fail "nothing to install beside this script; name a checkout or a wheel with --from"
    fi
}

install() {
    check_python
    [ -n "$wheelhouse$from" ] || [ ! -e "$here/BUILT-FOR" ] || wheelhouse=$here
    mkdir -p "$prefix" "$bin" 2>/dev/null && [ -w "$prefix" ] && [ -w "$bin" ] ||
        fail "$prefix or $bin may not be written; repeat with sudo"
    if [ -n "$service" ] && [ "$(id -u)" != 0 ]; then fail "the service needs root; repeat with sudo, or --no-service"; fi
    exec 9>"$prefix/.lock"
    flock -n 9 || fail "another installation is under way"
    work=$(mktemp -d "$prefix/.work.XXXXXX")
    new=
    trap 'rm -rf "$work" ${new:+"$prefix/$new"}' EXIT

    local wheel pip=()
    if [ -n "$wheelhouse" ]; then
        wheelhouse=$(realpath "$wheelhouse")
        wheel=$(find "$wheelhouse" -name 'spheremouse-*.whl' | sort -V | tail -1)
        [ -n "$wheel" ] || fail "$wheelhouse: no wheel of spheremouse in it; make one with --build-wheelhouse"
        if [ -e "$wheelhouse/BUILT-FOR" ] && [ "$(cat "$wheelhouse/BUILT-FOR")" != "$(kind)" ]; then
            fail "$wheelhouse was built for $(cat "$wheelhouse/BUILT-FOR"), this is $(kind): build it on a machine like this"
        fi
        pip=(--no-index --find-links "$wheelhouse")
    else
        system_packages
        local what
        what=$(source_of)
        "$python" -m venv "$work/venv"
        "$work/venv/bin/pip" -q wheel --no-deps -w "$work" "$what"
        wheel=$(find "$work" -maxdepth 1 -name 'spheremouse-*.whl')
    fi
    local version name n=2
    version=$(basename "$wheel" | cut -d- -f2)
    name=$version
    while [ -e "$prefix/$name" ]; do
        name=$version-$n
        n=$((n + 1))
    done
    new=$name
    say "installing $version into $prefix/$name"
    if [ -n "$wheelhouse" ]; then # no ensurepip needed: pip runs from its own wheel
        "$python" -m venv --without-pip "$prefix/$name"
        "$prefix/$name/bin/python" "$(find "$wheelhouse" -name 'pip-*.whl' | sort -V | tail -1)/pip" \
            -q --disable-pip-version-check install "${pip[@]}" "$wheel${extras:+[$extras]}"
    else
        "$python" -m venv "$prefix/$name"
        "$prefix/$name/bin/pip" -q --disable-pip-version-check install "$wheel${extras:+[$extras]}"
    fi
    chmod -R go+rX "$prefix/$name"
    "$prefix/$name/bin/python" -m compileall -q "$prefix/$name/lib" >/dev/null || true # the service may not write there
    "$prefix/$name/bin/spheremouse" --version >/dev/null || fail "$version does not start; nothing was changed"
    "$prefix/$name/bin/python" -c 'import cv2, numba, scipy' || fail "$version lacks a library; nothing was changed"
    warm "$name"

    local before
    before=$(in_use current)
    new= # from here on it stays
    if ! switch "$name" || { [ -z "$before" ] && ! warm "$name"; } || ! healthy; then # warm: now there is its user
        say "$version does not come up"
        if [ -n "$before" ] && [ -d "$prefix/$before" ]; then
            ! systemd_runs || journalctl -u spheremouse -n 15 --no-pager -o cat | sed 's/^/    /' || true
            (back_to "$before") || true
            rm -rf "${prefix:?}/$name"
            exit 1
        fi
        fail "there is no version before it; see: journalctl -u spheremouse"
    fi
    point "$bin/spheremouse" "$(program)"
    if [ -n "$before" ]; then point "$prefix/previous" "$before"; fi
    [ "$here" = "$(realpath "$prefix")" ] || cp "$here/install.sh" "$prefix/install.sh" # for --rollback and --uninstall
    local other
    for other in $(versions); do
        [ "$other" = "$name" ] || [ "$other" = "$before" ] || {
            say "removing $other"
            rm -rf "${prefix:?}/$other"
        }
    done
    say "spheremouse $version is in use ($(du -sh "$prefix/$name" | cut -f1))${before:+; back to $before with: $prefix/install.sh --rollback}"
}

rollback() {
    local before now
    before=$(in_use previous)
    now=$(in_use current)
    [ -n "$before" ] && [ -d "$prefix/$before" ] || fail "there is no version before $now in $prefix"
    [ -w "$prefix" ] || fail "$prefix may not be written; repeat with sudo"
    point "$prefix/previous" "$now"
    back_to "$before"
    say "forward again with: $prefix/install.sh --rollback"
}

uninstall() {
    [ -d "$prefix" ] || fail "nothing in $prefix"
    [ -w "$prefix" ] || fail "$prefix may not be written; repeat with sudo"
    if [ -n "$service" ] && [ -x "$(program)" ]; then "$(program)" service uninstall $purge; fi
    if [ "$(readlink "$bin/spheremouse" || true)" = "$(program)" ]; then rm -f "$bin/spheremouse"; fi
    local one
    for one in $(versions); do rm -rf "${prefix:?}/$one"; done
    rm -f "$prefix/current" "$prefix/previous" "$prefix/.lock" "$prefix/install.sh"
    rmdir "$prefix" || fail "$prefix is left: there is something in it that is not ours"
    say "$prefix is gone"
}

if [ -n "$build" ]; then action=build_wheelhouse; fi
"$action"
exit
