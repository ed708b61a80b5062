#!/usr/bin/env bash
# Install spheremouse on Debian, Ubuntu and Raspberry Pi OS, or upgrade it:
#     sudo bash service/install.sh
# Each version has a virtual environment of its own below /opt/spheremouse. The link `current` leads to the one in use.
# If a new version does not start, the script switches back. See --help.
#
# Packages come by the hashes in service/*.lock. Root refuses a source, a wheelhouse or a target that others may change
# (private_to_root), and builds packages in a folder that only root may enter.
set -euo pipefail
umask 022 # the service's user must be able to read all of it
unset PYTHONPATH PYTHONHOME

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
patience=${SPHEREMOUSE_PATIENCE:-300} # s until a version must have started
python=${PYTHON:-python3}

usage() {
    cat <<END
usage: install.sh [options]
  (none)                install, or upgrade, from the checkout this script is in (or the wheels beside it)
  --from WHAT           another checkout or wheel
  --wheelhouse DIR      without network: all wheels are in DIR
  --build-wheelhouse DIR  fill DIR with all wheels and this script, for machines without network of the same kind
  --extras A,B          optional parts: metrics (for Prometheus)
  --rollback            switch back to the version before
  --uninstall           stop and remove the service and all versions; --purge: configuration and calibration, too
  --prefix DIR          where versions go, in place of /opt/spheremouse
  --bin DIR             where the command goes, in place of /usr/local/bin
  --no-service          the program only
END
}
say() { echo "install.sh: $*"; }
printable() { LC_ALL=C.UTF-8 sed -u 's/[^[:print:]]/?/g'; } # removes escape characters
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
absolute() { case $1 in '' | /*) printf %s "$1" ;; *) printf %s "$PWD/$1" ;; esac; }
prefix=$(absolute "$prefix") bin=$(absolute "$bin") wheelhouse=$(absolute "$wheelhouse")
from=$(absolute "$from") build=$(absolute "$build")
case $python in */*) python=$(absolute "$python") ;; esac
exec </dev/null
cd / # Python would import modules from the current folder

# ---- what the system must have ----

check_python() {
    command -v "$python" >/dev/null || fail "there is no $python; on Debian: apt-get install python3"
    "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' || fail "spheremouse needs Python 3.11 or newer," \
        "$python is $("$python" -V): take Debian 12, Ubuntu 24.04, Raspberry Pi OS 12 or newer, or PYTHON=/path install.sh"
}

# Install a Python that makes virtual environments, and a compiler for evdev, which has no wheels.
system_packages() {
    local missing=() name=python3
    [ "$(command -v "$python")" = /usr/bin/python3 ] || [ "$python" = python3 ] || name=$(basename "$python")
    "$python" -c 'import venv, ensurepip' 2>/dev/null || missing+=("$name-venv")
    command -v c++ >/dev/null || missing+=(g++ libc6-dev)
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

# Install the packages of the tray if there is a desktop. pip would have to compile them.
tray() {
    local packages=(python3-gi gir1.2-ayatanaappindicator3-0.1)
    [ -n "$service" ] && compgen -G '/usr/share/*sessions/*.desktop' >/dev/null || return 0
    ! /usr/bin/python3 -c 'import gi; gi.require_version("AyatanaAppIndicator3", "0.1")' 2>/dev/null || return 0
    if [ -z "$wheelhouse" ] && command -v apt-get >/dev/null; then
        say "apt-get installs ${packages[*]}, for the tray"
        DEBIAN_FRONTEND=noninteractive apt-get -qq -o DPkg::Lock::Timeout=300 install -y --no-install-recommends \
            "${packages[@]}" >/dev/null 2>&1 && return 0
    fi
    say "the tray needs packages of the system: apt-get install ${packages[*]}"
}

# private_to_root FOLDER [caller]: fail if this is root and others may change the folder, one above it, or a link on the
# way: they could decide what root runs. With `caller`, the user who has called sudo counts as root. The folder need not
# exist. The members of group staff, to whom /usr/local belongs on older systems, count as root too.
private_to_root() {
    [ "$(id -u)" = 0 ] || return 0
    local path mode owner group gid writes users=" 0 " groups=" 0 "
    if [ "${2-}" = caller ]; then users+="${SUDO_UID-} " groups+="${SUDO_GID-} "; fi
    for path in "$1" "$(realpath -m "$1")"; do # the path with its links, and without
        writes=022
        while :; do
            if [ -e "$path" ]; then
                read -r mode owner group gid < <(stat -Lc '%a %u %G %g' "$path")
                if [[ $groups = *" $gid "* || $group = staff ]]; then writes=$((writes & 002)); fi
                [[ $users = *" $owner "* ]] && (((0$mode & writes) == 0)) ||
                    fail "$1: others than root may change what is in $path;" \
                    "take a folder that only root may write, or install without sudo and with --no-service"
                if [ "${2-}" != caller ] && [ -n "$service" ] && ! ((0$mode & 1)); then
                    fail "$path: the service's user may not enter it; chmod 755 $path"
                fi
                if [ -L "$path" ]; then
                    owner=$(stat -c %u "$path")
                    [[ $users = *" $owner "* ]] || fail "$1: others than root may change the link $path"
                fi
            fi
            [ "$path" != / ] || break
            path=$(dirname "$path")
            writes=022
            if [ -k "$path" ]; then writes=0; fi # in /tmp nobody can exchange the files of others
        done
    done
}

# private_content PATH...: fail if this is root and others may change a file in one of the paths
private_content() {
    [ "$(id -u)" = 0 ] || return 0
    local found
    found=$(find "$@" ! -type l \( \( ! -uid 0 ! -uid "${SUDO_UID:-0}" \) -o -perm /002 -o \
        \( -perm /020 ! -gid 0 ! -gid "${SUDO_GID:-0}" \) \) -print -quit)
    [ -z "$found" ] || fail "$(printable <<<"$found"): others than root may change it; copy the release as root"
}

kind() { "$python" -c 'import sys, platform; print(f"Python {sys.version_info[0]}.{sys.version_info[1]}, {platform.machine()}")'; }

# ---- versions ----

# List the installed versions: folders of the prefix with a virtual environment that has the program.
versions() {
    local path
    for path in "$prefix"/*; do
        if [ ! -L "$path" ] && [ -e "$path/pyvenv.cfg" ] && [ -e "$path/bin/spheremouse" ]; then basename "$path"; fi
    done
}
# in_use NAME: the folder that the link NAME (current or previous) leads to, or nothing
in_use() { if [ -L "$prefix/$1" ]; then basename "$(readlink "$prefix/$1")"; fi; }
share=$(dirname "$bin")/share # where shells and man look for what belongs to the command
point() { # point LINK TARGET: replace the link in one step
    ln -sfn "$2" "$1.new"
    mv -Tf "$1.new" "$1"
}
point_shared() {
    local one
    [ -d "$prefix/current/share" ] || return 0
    (cd "$prefix/current/share" && find . -name '*spheremouse*' -type f -printf '%P\n') | while IFS= read -r one; do
        mkdir -p "$(dirname "$share/$one")"
        point "$share/$one" "$prefix/current/share/$one"
    done
}
systemd_runs() { [ -n "$service" ] && [ -d /run/systemd/system ]; }
program() { printf %s "$prefix/current/bin/spheremouse"; }

# Does the service answer? Without a rig it does not start, and need not answer.
healthy() {
    systemd_runs || return 0
    local until=$((SECONDS + patience))
    if ! systemctl is-enabled -q spheremouse.service || [ ! -e /etc/spheremouse/rig.yaml ]; then
        say "the service is not started: /etc/spheremouse/rig.yaml is missing, or the service is disabled"
        return 0
    fi
    timeout "$patience" systemctl restart spheremouse.service || true # returns once the service is ready or has failed
    until [ "$(systemctl is-active spheremouse.service)" = active ] &&
        timeout 20 "$(program)" ctl status >/dev/null 2>&1; do
        if [ $SECONDS -ge $until ]; then return 1; fi
        sleep 2
    done
    sleep 3 # it must still run then
    [ "$(systemctl is-active spheremouse.service)" = active ] && timeout 20 "$(program)" ctl status
}

# Make a version the one in use, and place its service files.
switch() { # switch NAME
    point "$prefix/current" "$1"
    [ -z "$service" ] || "$(program)" service install --no-start
}

back_to() { # back_to NAME
    say "switching back to $1"
    switch "$1" || say "the service's files of $1 could not be placed: $(program) service install"
    healthy || fail "$1 does not come up either; see: journalctl -u spheremouse"
    say "$1 is in use again"
}

# ---- packages ----

# Make the folder to build in, which only its user may enter, with a virtual environment that has what builds.
make_room() {
    room=$(mktemp -d)
    "$python" -m venv "$room/venv"
    mkdir "$room/build" "$room/home"
}
in_room() { (cd "$room/build" && env "HOME=$room/home" "TMPDIR=$room/home" "$@" 9>&-); }

# run WORDS COMMAND...: if the command fails, fail with its lines about errors in one line
run() {
    local words=$1
    shift
    "$@" >"$work/said" 2>&1 || fail "$words: $( (grep -iE '^ *error' "$work/said" ||
        tail -n1 "$work/said") | paste -sd' ' | tr -s ' ' | printable)"
}
text_of() { [ -f "$1" ] && [ ! -L "$1" ] && cat "$1"; } # a release has no links

# Fill $work/wheels with the program and its packages: the wheels that the release's lock names, and those built here
# from the sources that it names.
fetch() {
    local what lock one pip name_ok='^[A-Za-z0-9][A-Za-z0-9._+-]*[.]whl$'
    what=$(source_of)
    private_to_root "${from:-$what}" caller
    local parts=(pyproject.toml CMakeLists.txt README.md LICENSE spheremouse service docs/sample.schema.json calibration/device.yaml)
    if [ -d "$what" ]; then private_content "${parts[@]/#/$what/}"; fi
    system_packages
    if [ -f "$what" ]; then
        [[ ${what##*/} =~ $name_ok ]] || fail "$what is no wheel and no checkout"
        text_of "$what" >"$work/wheels/${what##*/}"
    fi
    for lock in requirements.lock sources.lock; do # the release's own, from whichever form it comes in
        if [ -d "$what" ]; then
            text_of "$what/service/$lock"
        else
            "$python" -c 'import sys, zipfile; print(zipfile.ZipFile(sys.argv[1]).read(sys.argv[2]).decode())' \
                "$work/wheels/${what##*/}" "spheremouse/_service/$lock"
        fi >"$work/$lock" 2>/dev/null || fail "$what has no $lock, the list of packages: take a whole release"
    done
    make_room
    pip=("$room/venv/bin/python" -m pip -q --disable-pip-version-check)
    say "fetching the packages of requirements.lock"
    run "packages of $what/service/requirements.lock could not be fetched" \
        "${pip[@]}" download --no-deps --require-hashes --only-binary :all: -d "$work/wheels" \
        -r "$work/requirements.lock"
    run "requirements.lock lacks a build package" \
        "${pip[@]}" install --upgrade --no-index --find-links "$work/wheels" \
        pip scikit-build-core hatch-fancy-pypi-readme nanobind cmeel-eigen cmake ninja setuptools
    say "building the packages of sources.lock, and spheremouse"
    pip+=(wheel --no-deps --no-build-isolation -w wheels)
    run "packages of $what/service/sources.lock could not be built" \
        in_room "${pip[@]}" --require-hashes -r "$work/sources.lock"
    if [ -d "$what" ]; then
        mkdir "$room/build/source"
        tar -C "$what" --exclude=__pycache__ --exclude='*.so' -c "${parts[@]}" |
            tar -C "$room/build/source" --no-same-owner -x
        run "$what: no wheel can be built from it" in_room "${pip[@]}" --no-index ./source
    fi
    mv "$room"/build/wheels/*.whl "$work/wheels/"
}

# Fill $work/wheels from a folder of --build-wheelhouse with the files that SHA256SUMS names, if their hashes agree.
take() {
    local kinds name sum
    private_to_root "$wheelhouse" caller
    private_content "$wheelhouse"
    kinds=$(text_of "$wheelhouse/BUILT-FOR") && text_of "$wheelhouse/SHA256SUMS" >"$work/SHA256SUMS" ||
        fail "$wheelhouse: no BUILT-FOR and SHA256SUMS in it; make the folder with --build-wheelhouse"
    [ "$kinds" = "$(kind)" ] ||
        fail "$wheelhouse was built for $kinds, this is $(kind): build it on a machine like this"
    while read -r sum name; do
        [[ $name =~ ^[A-Za-z0-9][A-Za-z0-9._+-]*[.]whl$ ]] || fail "$wheelhouse/SHA256SUMS: a line names no wheel; copy the folder again"
        text_of "$wheelhouse/$name" >"$work/wheels/$name" && [ "$(sha256sum <"$work/wheels/$name")" = "$sum  -" ] ||
            fail "$wheelhouse/$name is not the file that SHA256SUMS names; copy the folder again"
    done <"$work/SHA256SUMS"
    say "$wheelhouse is as it was built; its SHA256SUMS has $(sha256sum "$work/SHA256SUMS" | cut -d' ' -f1)"
}

# ---- actions ----

build_wheelhouse() {
    check_python
    private_to_root "$build" caller
    work=$(mktemp -d)
    trap 'rm -rf "$work" ${room:+"$room"}' EXIT
    mkdir "$work/wheels"
    fetch
    (cd "$work/wheels" && sha256sum -- *.whl >SHA256SUMS)
    kind >"$work/wheels/BUILT-FOR"
    cp "$here/install.sh" "$work/wheels/"
    mkdir -p "$build"
    tar -C "$work/wheels" -c . | tar -C "$build" --no-same-owner --no-overwrite-dir -x
    say "$build: $(grep -c . "$work/wheels/SHA256SUMS") wheels, $(du -sh "$work/wheels" | cut -f1), for $(kind)"
    say "its SHA256SUMS has $(sha256sum "$work/wheels/SHA256SUMS" | cut -d' ' -f1)"
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
    trap 'rm -rf "$work" ${room:+"$room"} ${new:+"$prefix/$new"}' EXIT
    mkdir "$work/wheels"
    if [ -n "$wheelhouse" ]; then take; else fetch; fi

    local wheel
    wheel=$(find "$work/wheels" -name 'spheremouse-*.whl')
    [ -n "$wheel" ] || fail "$wheelhouse: no wheel of spheremouse in it; make one with --build-wheelhouse"
    local version name n=2
    version=$(basename "$wheel" | cut -d- -f2)
    name=$version
    while [ -e "$prefix/$name" ]; do
        name=$version-$n
        n=$((n + 1))
    done
    new=$name
    say "installing $version into $prefix/$name"
    # pip runs from its own wheel, which needs no ensurepip, and reads no settings, which could name other packages
    "$python" -m venv --without-pip "$prefix/$name"
    PIP_CONFIG_FILE=/dev/null run "$version was not installed" "$prefix/$name/bin/python" \
        "$(find "$work/wheels" -name 'pip-*.whl')/pip" --isolated -q --disable-pip-version-check install --no-cache-dir \
        --no-index --find-links "$work/wheels" --only-binary :all: "$wheel${extras:+[$extras]}"
    "$prefix/$name/bin/python" -m compileall -q "$prefix/$name/lib" >/dev/null || true # the service cannot write there
    chmod -R go+rX "$prefix/$name"
    "$prefix/$name/bin/spheremouse" --version >/dev/null || fail "$version does not start; nothing was changed"
    "$prefix/$name/bin/python" -c 'import cv2, scipy' || fail "$version lacks a library; nothing was changed"

    local before
    before=$(in_use current)
    new= # keep it from here on
    if ! switch "$name" || ! healthy; then
        say "$version does not come up"
        if [ -n "$before" ] && [ -d "$prefix/$before" ]; then
            ! systemd_runs || journalctl -u spheremouse -n 15 --no-pager -o cat | printable | sed 's/^/    /' || true
            (back_to "$before") || true
            rm -rf "${prefix:?}/$name"
            exit 1
        fi
        fail "there is no version before it; see: journalctl -u spheremouse"
    fi
    point "$bin/spheremouse" "$(program)"
    point_shared || say "no man page and no completion: $share may not be written"
    tray
    if [ -n "$before" ]; then point "$prefix/previous" "$before"; fi
    if [ "$here" != "$(realpath "$prefix")" ]; then # --rollback and --uninstall use it
        text_of "$here/install.sh" >"$prefix/.install.sh"
        chmod 755 "$prefix/.install.sh"
        mv -f "$prefix/.install.sh" "$prefix/install.sh"
    fi
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
    find "$share" -lname "$prefix/current/share/*" -delete 2>/dev/null || true
    if [ "$(readlink "$bin/spheremouse" || true)" = "$(program)" ]; then rm -f "$bin/spheremouse"; fi
    local one
    for one in $(versions); do rm -rf "${prefix:?}/$one"; done
    rm -f "$prefix/current" "$prefix/previous" "$prefix/.lock" "$prefix/install.sh"
    rmdir "$prefix" || fail "$prefix is left: there is something in it that is not ours"
    say "$prefix is gone"
}

if [ -n "$build" ]; then
    action=build_wheelhouse
else
    private_to_root "$prefix"
    private_to_root "$bin"
fi
"$action"
exit
