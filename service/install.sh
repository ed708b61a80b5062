#!/usr/bin/env bash
# Installs spheremouse on Debian, Ubuntu and Raspberry Pi OS, or another version of it beside the one that is there:
#     sudo bash service/install.sh
# A virtual environment per version under /opt/spheremouse, `current` leads to the one in use, and the service runs from
# there. A version that does not come up is switched back. See --help.
#
# As root it runs no code but its own and what it installs: packages come as wheels, by the hashes of the release's
# service/*.lock, and what there are no wheels of is built by a user who exists for that alone (as_builder).
set -euo pipefail
umask 022 # the service's user reads all of it, whoever installs
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
patience=${SPHEREMOUSE_PATIENCE:-300} # s that a version may take to come up: the first start compiles
python=${PYTHON:-python3}

usage() {
    cat <<END
usage: install.sh [options]
  (none)                install, or upgrade, from the checkout this script is in (or the wheels beside it)
  --from WHAT           another checkout or wheel
  --wheelhouse DIR      without network: all wheels are in DIR
  --build-wheelhouse DIR  fill DIR with all wheels and this script, for machines without network of the same kind
  --extras A,B          optional parts: metrics (for Prometheus), lab (for experiments)
  --rollback            switch back to the version before
  --uninstall           stop and remove the service and all versions; --purge: configuration and calibration, too
  --prefix DIR          where versions go, in place of /opt/spheremouse
  --bin DIR             where the command goes, in place of /usr/local/bin
  --no-service          the program only
END
}
say() { echo "install.sh: $*"; }
printable() { LC_ALL=C.UTF-8 sed -u 's/[^[:print:]]/?/g'; } # what others than root wrote may steer a terminal
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
cd / # Python imports from the folder it is called in, which may be anybody's

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

# The tray's menu, where there is a desktop: by the distribution, since pip would have to compile it.
tray() {
    local packages=(python3-gi gir1.2-ayatanaappindicator3-0.1)
    [ -n "$service" ] && compgen -G '/usr/share/*sessions/*.desktop' >/dev/null || return 0
    ! /usr/bin/python3 -c 'import gi; gi.require_version("AyatanaAppIndicator3", "0.1")' 2>/dev/null || return 0
    if [ -z "$wheelhouse" ] && command -v apt-get >/dev/null; then
        say "apt-get installs ${packages[*]}, for the tray's menu"
        DEBIAN_FRONTEND=noninteractive apt-get -qq -o DPkg::Lock::Timeout=300 install -y --no-install-recommends \
            "${packages[@]}" >/dev/null 2>&1 && return 0
    fi
    say "the tray has no menu before: apt-get install ${packages[*]}"
}

# roots_own FOLDER: whoever may write it, or a folder above it, decides in the end what root runs from there. It may not
# be there yet. /usr/local is of the group staff on older systems, whose members are as good as root.
roots_own() {
    [ "$(id -u)" = 0 ] || return 0
    local path mode owner group writes
    for path in "$1" "$(realpath -m "$1")"; do # with links, and where they lead
        writes=022
        while :; do
            if [ -e "$path" ]; then
                read -r mode owner group < <(stat -Lc '%a %u %G' "$path")
                [[ $group != @(root|staff) ]] || writes=$((writes & 002))
                [ "$owner" = 0 ] && (((0$mode & writes) == 0)) ||
                    fail "$1: others than root may change what is in $path;" \
                    "take a folder that is root's alone, or install without sudo and with --no-service"
                [ -z "$service" ] || ((0$mode & 1)) || fail "$path: the service's user may not enter it; chmod 755 $path"
            fi
            [ "$path" != / ] || break
            path=$(dirname "$path")
            writes=022
            # in /tmp and the like nobody can move what is another's
            if [ -k "$path" ]; then writes=0; fi
        done
    done
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
share=$(dirname "$bin")/share # where shells and man look for what belongs to the command
point() { # point LINK TARGET: at any moment there is the old link or the new one
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
    # what it finds in its cache is its own affair; without our terminal it cannot type there
    # and what it leaves behind can hold up neither us (a pipe, a clock) nor the next installation (the lock, 9)
    timeout -k 10 "$patience" setsid -w runuser -u spheremouse -- env NUMBA_CACHE_DIR=/var/cache/spheremouse \
        "$prefix/$1/bin/python" -m spheremouse.ball.warm </dev/null >"$work/said" 2>&1 9>&- &
    tail -f -s 1 -n +1 --pid=$! "$work/said" | printable
    wait $! || say "compiling beforehand did not work; the first start will do it"
}

back_to() { # back_to NAME
    say "switching back to $1"
    switch "$1" || say "the service's files of $1 could not be placed: $(program) service install"
    healthy || fail "$1 does not come up either; see: journalctl -u spheremouse"
    say "$1 is in use again"
}

# ---- packages ----

# as_owner PATH COMMAND...: with the rights of whoever owns a path; root reads and writes nothing in others' folders
as_owner() {
    local uid gid groups=--init-groups
    read -r uid gid < <(stat -Lc '%u %g' "$1")
    shift
    if [ "$(id -u)" != 0 ] || [ "$uid" = 0 ]; then
        "$@"
    else
        getent passwd "$uid" >/dev/null || groups=--clear-groups
        setsid -w setpriv --reuid "$uid" --regid "$gid" "$groups" "$@" 9>&-
    fi
}

# With the rights of a user whom nothing belongs to and nobody else is, as systemd's DynamicUser makes them; where one is
# not root, with one's own. Without a terminal: what runs could type into it.
builder=
as_builder() {
    local drop=()
    if [ "$(id -u)" = 0 ]; then
        drop=(setsid -w setpriv --reuid "$builder" --regid "$builder" --clear-groups --no-new-privs
            env "HOME=$room/build" "TMPDIR=$room/build")
    fi
    (cd "$room/build" && "${drop[@]}" "$@" 9>&-)
}

# The room, in the temporary folder, since a builder need not be able to enter the prefix: a virtual environment of root's
# that is built with, and a folder of the builder's that is built in.
make_room() {
    room=$(mktemp -d)
    chmod 711 "$room"
    "$python" -m venv "$room/venv"
    mkdir -m 700 "$room/build"
    [ "$(id -u)" = 0 ] || return 0
    local _
    for _ in {1..100}; do
        builder=$((61184 + RANDOM % 4336))
        getent passwd "$builder" >/dev/null || [ -n "$(find /proc -maxdepth 1 -uid "$builder")" ] || break
    done
    chown "$builder:$builder" "$room/build"
    as_builder "$room/venv/bin/python" -c 'import os; assert os.getuid()' 2>/dev/null ||
        fail "packages are not built as root, and others cannot run $python: PYTHON=/usr/bin/python3 bash install.sh"
}

# run WORDS COMMAND...: where it does not work, one line with what it called errors
run() {
    local words=$1
    shift
    "$@" >"$work/said" 2>&1 || fail "$words: $( (grep -iE '^ *error' "$work/said" ||
        tail -n1 "$work/said") | paste -sd' ' | tr -s ' ' | printable)"
}
text_of() { [ -f "$1" ] && as_owner "$1" cat "$1"; }

# Fill $work/wheels with the program and all it may need: wheels that the release's lock names, or that are made here
# from the source that it names.
fetch() {
    local what lock one pip name_ok='^[A-Za-z0-9][A-Za-z0-9._+-]*[.]whl$'
    what=$(source_of)
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
        fi >"$work/$lock" 2>/dev/null || fail "$what has no $lock, which says what to install: take a whole release"
    done
    make_room
    cp "$work/sources.lock" "$room/"
    pip=("$room/venv/bin/python" -m pip -q --disable-pip-version-check)
    say "fetching what requirements.lock names"
    run "what $what/service/requirements.lock names is not to be had" \
        "${pip[@]}" download --no-deps --require-hashes --only-binary :all: -d "$work/wheels" \
        -r "$work/requirements.lock"
    run "requirements.lock lacks what builds" \
        "${pip[@]}" install --upgrade --no-index --find-links "$work/wheels" pip hatchling hatch-fancy-pypi-readme setuptools
    say "building what comes as source"
    pip+=(wheel --no-deps --no-build-isolation -w wheels)
    run "what $what/service/sources.lock names is not to be had" \
        as_builder "${pip[@]}" --require-hashes -r "$room/sources.lock"
    if [ -d "$what" ]; then
        as_builder mkdir source
        as_owner "$what" tar -C "$what" --exclude=__pycache__ -c pyproject.toml README.md LICENSE spheremouse service |
            as_builder tar -C source -x
        run "$what: no wheel can be made of it" as_builder "${pip[@]}" --no-index ./source
    fi
    for one in $(as_builder find wheels -type f -printf '%f\n'); do
        [[ $one =~ $name_ok ]] || fail "$one: no wheel was asked for by that name"
        as_builder cat "wheels/$one" >"$work/wheels/$one" # the builder reads: a link that it left leads it nowhere new
    done
}

# Fill $work/wheels from a folder that --build-wheelhouse made: what SHA256SUMS names there, if it is that.
take() {
    local kinds name sum
    kinds=$(text_of "$wheelhouse/BUILT-FOR") && text_of "$wheelhouse/SHA256SUMS" >"$work/SHA256SUMS" ||
        fail "$wheelhouse: no BUILT-FOR and SHA256SUMS in it; make the folder with --build-wheelhouse"
    [ "$kinds" = "$(kind)" ] ||
        fail "$wheelhouse was built for $kinds, this is $(kind): build it on a machine like this"
    while read -r sum name; do
        [[ $name =~ ^[A-Za-z0-9][A-Za-z0-9._+-]*[.]whl$ ]] || fail "$wheelhouse/SHA256SUMS: $name is no name of a wheel"
        text_of "$wheelhouse/$name" >"$work/wheels/$name" && [ "$(sha256sum <"$work/wheels/$name")" = "$sum  -" ] ||
            fail "$wheelhouse/$name is not the file that SHA256SUMS names; carry the folder over anew"
    done <"$work/SHA256SUMS"
    say "$wheelhouse is as it was built; its SHA256SUMS has $(sha256sum "$work/SHA256SUMS" | cut -d' ' -f1)"
}

# ---- actions ----

build_wheelhouse() {
    check_python
    work=$(mktemp -d)
    trap 'rm -rf "$work" ${room:+"$room"}' EXIT
    mkdir "$work/wheels"
    fetch
    (cd "$work/wheels" && sha256sum -- *.whl >SHA256SUMS)
    kind >"$work/wheels/BUILT-FOR"
    cp "$here/install.sh" "$work/wheels/"
    local to there
    to=$(realpath -m "$build") # a link leads nowhere that its owner may not write
    there=$to
    while [ ! -e "$there" ]; do there=$(dirname "$there"); done
    if [ "$(stat -c %u "$there")" = 0 ]; then service='' roots_own "$build"; fi
    as_owner "$there" mkdir -p "$to"
    tar -C "$work/wheels" -c . | as_owner "$there" tar -C "$to" --no-same-owner -x
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
    # pip from its own wheel, which needs no ensurepip; no setting of pip's brings in what was not looked at
    "$python" -m venv --without-pip "$prefix/$name"
    PIP_CONFIG_FILE=/dev/null run "$version was not installed" "$prefix/$name/bin/python" \
        "$(find "$work/wheels" -name 'pip-*.whl')/pip" --isolated -q --disable-pip-version-check install --no-cache-dir \
        --no-index --find-links "$work/wheels" --only-binary :all: "$wheel${extras:+[$extras]}"
    "$prefix/$name/bin/python" -m compileall -q "$prefix/$name/lib" >/dev/null || true # the service may not write there
    chmod -R go+rX "$prefix/$name"
    "$prefix/$name/bin/spheremouse" --version >/dev/null || fail "$version does not start; nothing was changed"
    "$prefix/$name/bin/python" -c 'import cv2, numba, scipy' || fail "$version lacks a library; nothing was changed"
    warm "$name"

    local before
    before=$(in_use current)
    new= # from here on it stays
    if ! switch "$name" || { [ -z "$before" ] && ! warm "$name"; } || ! healthy; then # warm: now there is its user
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
    if [ "$here" != "$(realpath "$prefix")" ]; then # for --rollback and --uninstall
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
    roots_own "$prefix"
    roots_own "$bin"
fi
"$action"
exit
