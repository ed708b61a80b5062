#!/bin/bash
# Run one command as root in a QEMU guest that has a real kernel with uinput, evdev, USB and cameras on top of this
# machine's own files: the guest sees them read-only, what it writes goes to its memory, and nothing outside can be harmed.
#
#     run_in_vm.sh [--setup] [--timeout SECONDS] [--system DIR] COMMAND [ARGUMENT...]
#
# With --system the guest's own files are those of DIR, a Debian with systemd (mmdebstrap makes one), which boots as it
# would anywhere; this machine's are in /host, read-only.
# Starts in the current folder. Standard output and error of the command come out here, together. Exit code: that of
# the command, 123 at most; 124 after the timeout (300 s unless given); 125 if the guest could not be made or died.
# The kernel is Debian's linux-image-amd64, downloaded once (70 MB) and kept with an initramfs in
# ${XDG_CACHE_HOME:-~/.cache}/spheremouse-vm; nothing of it is installed. Another kernel: SPHEREMOUSE_VM_KERNEL=DIR,
# a folder with boot/vmlinuz-VERSION and lib/modules/VERSION ("/" for the machine's own, where those can be read).
# Cameras are not loaded, but lie in /run/cameras: NAME lists the files that insmod takes, in their order, the module
# itself last; NAME.missing says why there is none. v4l2loopback is built for that kernel, once, from Debian's source
# package and headers (14 MB more), where gcc and make are at hand.
set -euo pipefail

cache=${XDG_CACHE_HOME:-$HOME/.cache}/spheremouse-vm
modules="virtio_pci 9pnet_virtio 9p overlay evdev uinput" # the first four make the root file system
modules+=" libcomposite usb_f_hid usb_f_acm dummy_hcd usbhid hid-generic cdc-acm" # a USB device in software, and its drivers
cameras="vivid v4l2loopback"
limit=300

say() { echo "run_in_vm: $*" >&2; }
die() { say "$@"; exit 125; }

check_tools() {
    local missing=()
    command -v qemu-system-x86_64 >/dev/null || missing+=(qemu-system-x86)
    command -v cpio >/dev/null || missing+=(cpio)
    command -v /sbin/modprobe >/dev/null || missing+=(kmod)
    static_busybox || missing+=(busybox-static)
    [ "${#missing[@]}" = 0 ] ||
        die "QEMU cannot be had here; as root: apt-get update && apt-get install --no-install-recommends ${missing[*]}"
}

static_busybox() { [ -x /bin/busybox ] && ! ldd /bin/busybox >/dev/null 2>&1; }

# A folder with boot/vmlinuz-* and lib/modules, in $kernel.
fetch_kernel() {
    local new=$1 package
    if [ -n "${SPHEREMOUSE_VM_KERNEL:-}" ]; then
        kernel=$SPHEREMOUSE_VM_KERNEL
        return
    fi
    command -v apt-get >/dev/null || die "no apt-get here to fetch a kernel with; name one in SPHEREMOUSE_VM_KERNEL"
    package=$(apt-cache depends linux-image-amd64 2>/dev/null | awk '/Depends: linux-image-[0-9]/ { print $2; exit }')
    [ -n "$package" ] || die "apt knows no linux-image-amd64; run apt-get update, or set SPHEREMOUSE_VM_KERNEL"
    say "fetching $package (once)"
    (cd "$new" && apt-get -qq download "$package" 2>/dev/null) || die "could not download $package"
    kernel=$new/kernel
    dpkg-deb -x "$new"/*.deb "$kernel"
    rm -f "$new"/*.deb
}

# Into the modules of a fetched kernel; on failure the reason is the only output.
build_loopback() {
    local new=$1 version=$2 tree=$1/headers packages package
    [ -z "${SPHEREMOUSE_VM_KERNEL:-}" ] || { echo "this kernel has none"; return 1; }
    command -v gcc >/dev/null && command -v make >/dev/null || { echo "gcc and make are needed to build it"; return 1; }
    packages=$(apt-cache depends "linux-headers-$version" 2>/dev/null |
        awk '/Depends: linux-(headers|kbuild)-/ { print $2 }')
    [ -n "$packages" ] || { echo "apt knows no linux-headers-$version"; return 1; }
    mkdir -p "$tree"
    # shellcheck disable=SC2086  # a list
    (cd "$tree" && apt-get -qq download v4l2loopback-dkms "linux-headers-$version" $packages 2>/dev/null) ||
        { echo "its source or the kernel's headers could not be downloaded"; return 1; }
    for package in "$tree"/*.deb; do dpkg-deb -x "$package" "$tree"; done
    sed -i "s#/usr/src/#$tree/usr/src/#" "$tree/usr/src/linux-headers-$version/Makefile"
    make -s -C "$tree/usr/src/linux-headers-$version" M="$(echo "$tree"/usr/src/v4l2loopback-*)" modules \
        >"$new/make" 2>&1 || { echo "it could not be built: $(grep -iE 'error|not found' "$new/make" | head -1)"; return 1; }
    mkdir -p "$kernel/lib/modules/$version/extra"
    cp "$tree"/usr/src/v4l2loopback-*/v4l2loopback.ko "$kernel/lib/modules/$version/extra/"
}

# The files that a module needs, in loading order, itself last.
files_of() { /sbin/modprobe -d "$kernel" -S "$version" --show-depends "$1" 2>/dev/null | awk '/^insmod/ { print $2 }'; }

# A module's file, unpacked.
unpacked() {
    case $1 in
    *.xz) xz -dc "$1" ;;
    *.zst) zstd -qdc "$1" ;;
    *) cat "$1" ;;
    esac
}

# The kernel, and an initramfs of busybox, the modules in loading order, and `guest_init`.
setup() {
    local new version module file target reason number=100
    mkdir -p "$(dirname "$cache")"
    new=$(mktemp -d "$cache.XXXXXX")
    trap 'rm -rf "$new"' EXIT
    fetch_kernel "$new"
    version=$(basename "$(find "$kernel/boot" -name 'vmlinuz-*' | sort -V | tail -1)" | sed s/^vmlinuz-//)
    [ -r "$kernel/boot/vmlinuz-$version" ] || die "$kernel/boot has no vmlinuz-* that can be read"
    reason=$(build_loopback "$new" "$version") || true
    [ "$kernel" = / ] || /sbin/depmod -b "$kernel" "$version"
    mkdir -p "$new/tree"/{bin,modules,cameras,proc,sys,dev,low,top,root}
    cp /bin/busybox "$new/tree/bin/"
    for module in $modules; do
        for file in $(files_of "$module"); do
            number=$((number + 1))
            unpacked "$file" >"$new/tree/modules/$number"
        done
    done
    for module in $cameras; do
        [ -n "$(files_of "$module")" ] ||
            { echo "no module $module: ${reason:-the kernel has none}" >"$new/tree/cameras/$module.missing"; continue; }
        for file in $(files_of "$module"); do
            target=$(basename "$file" | sed 's/[.][xz].*$//')
            unpacked "$file" >"$new/tree/cameras/$target"
            echo "$target" >>"$new/tree/cameras/$module"
        done
    done
    guest_init >"$new/tree/init"
    chmod 755 "$new/tree/init"
    (cd "$new/tree" && find . | cpio -o -H newc --quiet) >"$new/initrd"
    cp "$kernel/boot/vmlinuz-$version" "$new/vmlinuz"
    recipe >"$new/made_from"
    rm -rf "$new/tree" "$new/kernel" "$new/headers" "$new/make" "$cache"
    mv "$new" "$cache"
    trap - EXIT
    say "kernel $version is ready in $cache"
}

# Tells whether the cache was made by another version of this script.
recipe() {
    { echo "$modules" "$cameras" "${SPHEREMOUSE_VM_KERNEL:-}" && command -v gcc make; declare -f build_loopback guest_init; } |
        cksum
}

# What runs first in the guest. `job`, from the kernel's command line, is the path of the script to run. The command
# writes to the second serial port; its exit code, plus 1, leaves by QEMU's debug port. Modules that are loaded already (as
# another's need) are refused a second time, which does no harm.
guest_init() {
    cat <<'INIT'
#!/bin/busybox sh
B=/bin/busybox
leave() {
    $B printf "\\$($B printf %o $(($1 + 1)))" | $B dd of=/dev/port bs=1 seek=244 2>/dev/null
    $B poweroff -f
}
$B mount -t proc proc /proc
$B mount -t sysfs sys /sys
$B mount -t devtmpfs dev /dev
exec </dev/null >/dev/console 2>&1
for m in /modules/*; do $B insmod "$m" 2>/dev/null; done
$B mount -t 9p -o trans=virtio,version=9p2000.L,msize=512000,ro,cache=loose,noxattr root /low || leave 125
$B mount -t tmpfs -o size=75% top /top && $B mkdir /top/upper /top/work || leave 125
$B mount -t overlay -o lowerdir=/low$system,upperdir=/top/upper,workdir=/top/work all /root || leave 125
$B mount -t devtmpfs dev /root/dev && $B mount -t proc proc /root/proc && $B mount -t sysfs sys /root/sys || leave 125
$B mkdir -p /root/dev/shm && $B mount -t tmpfs shm /root/dev/shm
$B mount -t tmpfs run /root/run && $B cp -r /cameras /root/run/
$B ifconfig lo 127.0.0.1 up
$B stty -F /dev/ttyS1 raw -echo
if [ -n "$system" ]; then
    $B mkdir -p /root/host && $B mount --bind /low /root/host || leave 125
    cd /root/etc/systemd/system
    $B printf '[Service]\nExecStart=/bin/bash /etc/job\n' >job.service
    $B mkdir -p multi-user.target.wants && $B ln -s ../job.service multi-user.target.wants/
    $B cat >/root/etc/job <<JOB
/bin/bash /host$job </dev/null >/dev/ttyS1 2>&1
code=\$?
[ \$code -le 123 ] || code=123
printf "\\\\\$(printf %o \$((code + 1)))" | dd of=/dev/port bs=1 seek=244 2>/dev/null
JOB
    exec $B switch_root /root /sbin/init
fi
$B chroot /root /bin/bash "$job" >/dev/ttyS1 2>&1
code=$?
[ $code -le 123 ] || code=123
leave $code
INIT
}

while [ $# -gt 0 ]; do
    case $1 in
    --setup) only_setup=1; shift ;;
    --timeout) limit=$2; shift 2 ;;
    --system) system=$(realpath "$2"); shift 2 ;;
    -h | --help) sed -n '2,/^set /{/^set /d;s/^# \{0,1\}//;p}' "$0"; exit 0 ;;
    -*) die "unknown option $1" ;;
    *) break ;;
    esac
done
[ "$(uname -sm)" = "Linux x86_64" ] || die "the guest is an x86_64 Linux on top of this machine's own programs; this is $(uname -sm)"
check_tools
[ "$(cat "$cache/made_from" 2>/dev/null)" = "$(recipe)" ] || setup
[ -z "${only_setup:-}" ] || exit 0
[ $# -gt 0 ] || die "which command? run_in_vm.sh COMMAND [ARGUMENT...]"

job=$(mktemp -d)
trap 'rm -rf "$job"' EXIT
{
    printf 'cd %q && exec env -i IN_VM=1 TERM=dumb' "${system:+/host}$PWD"
    for name in PATH HOME LANG LC_ALL; do
        [ -z "${!name:-}" ] || printf ' %q' "$name=${!name}"
    done
    printf ' %q' "$@"
    echo
} >"$job/script"

# TCG, not KVM: it runs everywhere, inside other guests too. NumPy needs x86-64-v2. Its argsort for AVX2 crashes there.
code=0
timeout "$limit" qemu-system-x86_64 -M pc -m 1536 -accel tcg,thread=multi -cpu max,-avx2 -smp "$(nproc)" \
    -nodefaults -no-user-config -display none -no-reboot \
    -serial "file:$job/console" -chardev stdio,id=out,signal=off -serial chardev:out \
    -device isa-debug-exit,iobase=0xf4,iosize=1 \
    -fsdev local,id=root,path=/,security_model=none,readonly=on,multidevs=remap \
    -device virtio-9p-pci,fsdev=root,mount_tag=root \
    -object rng-random,id=rng,filename=/dev/urandom -device virtio-rng-pci,rng=rng \
    -kernel "$cache/vmlinuz" -initrd "$cache/initrd" \
    -append "console=ttyS0 quiet panic=-1 tsc=reliable clocksource=tsc no_timer_check mitigations=off random.trust_cpu=on job=$job/script ${system:+system=$system systemd.journald.forward_to_console=0}" \
    </dev/null 2>"$job/qemu" || code=$?
[ "$code" != 124 ] || { say "timed out after $limit s"; exit 124; }
# the debug port makes 2 n + 1 of a byte n, which is never 0; QEMU's own failure is 1, an orderly power-off 0
if [ "$code" -gt 1 ] && [ $((code % 2)) = 1 ] && [ "$code" != 253 ]; then
    exit $((code / 2 - 1))
fi
say "the guest did not come to run the command; its console ends:"
tail -20 "$job/console" >&2 || true
cat "$job/qemu" >&2
exit 125
