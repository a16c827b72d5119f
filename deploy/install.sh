#!/bin/sh
# Installs stadimeter as a service on a Raspberry Pi. May be run again, to update: it keeps your configuration.

set -eu
umask 022

usage() {
    cat <<'END'
usage: sudo sh deploy/install.sh [--dry-run] [--root DIR]

Installs the checkout that this script is in:
  /opt/stadimeter                              the program, in a virtual environment of its own
  /usr/lib/stadimeter/safe-outputs             switches outputs off after the program has ended
  /etc/systemd/system/stadimeter.service       the service; it is neither enabled nor started
  /etc/udev/rules.d/99-stadimeter.rules        names for robot bases
  /etc/modules-load.d/stadimeter.conf          drivers that must be loaded at boot
  /etc/stadimeter                              your configuration; what is there is left as it is

  --dry-run   print what would be done, and do nothing
  --root DIR  copy the files into DIR instead, for an image or a package; makes no user and no environment
END
}

fail() {
    printf 'install.sh: %s\n' "$*" >&2
    exit 2
}

dry_run=false
root=
while [ $# -gt 0 ]; do
    case $1 in
        --dry-run) dry_run=true ;;
        --root)
            [ -n "${2:-}" ] || fail "--root needs a directory"
            root=${2%/}
            shift
            ;;
        -h | --help)
            usage
            exit 0
            ;;
        *) fail "'$1' is not an option; see --help" ;;
    esac
    shift
done

here=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd)
checkout=$(dirname -- "$here")

run() {
    if $dry_run; then
        printf 'would run: %s\n' "$*"
    else
        "$@"
    fi
}

# put MODE FILE PLACE
put() {
    run install -D -m "$1" -- "$2" "$root$3"
}

# put_once MODE FILE PLACE
put_once() {
    if [ -e "$root$3" ]; then
        printf 'kept: %s\n' "$root$3"
    else
        put "$@"
        if [ -z "$root" ]; then
            run chown root:stadimeter "$3"
        fi
    fi
}

check() {
    [ -f "$checkout/pyproject.toml" ] || fail "$checkout is not a checkout of stadimeter"
    [ -f "$checkout/config/appliance.toml" ] || fail "$checkout/config/appliance.toml is missing"
    if [ -n "$root" ] || $dry_run; then
        return
    fi
    [ "$(id -u)" -eq 0 ] || fail "only root may install; run it with sudo, or look first with --dry-run"
    command -v systemctl >/dev/null || fail "this machine does not run systemd"
    python3 -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null ||
        fail "Python 3.11 or newer with venv is needed: apt install python3-venv"
}

make_user() {
    if ! getent passwd stadimeter >/dev/null; then
        run useradd --system --user-group --home-dir /var/lib/stadimeter --no-create-home --shell /usr/sbin/nologin stadimeter
    fi
    for group in gpio video dialout; do
        # The service does not start while one of them is missing.
        getent group "$group" >/dev/null || run groupadd --system "$group"
    done
}

install_program() {
    run python3 -m venv /opt/stadimeter
    run /opt/stadimeter/bin/pip install --quiet --upgrade "${checkout}[pi]"
}

install_files() {
    put 0755 "$here/safe-outputs" /usr/lib/stadimeter/safe-outputs
    put 0644 "$here/README.md" /opt/stadimeter/share/doc/stadimeter/deploy.md
    put 0644 "$here/stadimeter.service" /etc/systemd/system/stadimeter.service
    put 0644 "$here/99-stadimeter.rules" /etc/udev/rules.d/99-stadimeter.rules
    put 0644 "$here/modules-load.conf" /etc/modules-load.d/stadimeter.conf
    run install -d -m 0750 -- "$root/etc/stadimeter"
    if [ -z "$root" ]; then
        run chown root:stadimeter /etc/stadimeter
    fi
    put_once 0640 "$checkout/config/appliance.toml" /etc/stadimeter/appliance.toml
    put_once 0640 "$here/safe-outputs.conf" /etc/stadimeter/safe-outputs.conf
}

tell_the_system() {
    run systemctl daemon-reload
    run udevadm control --reload
    run systemctl restart systemd-modules-load.service
}

check
if [ -z "$root" ]; then
    make_user
    install_program
fi
install_files
if [ -z "$root" ]; then
    tell_the_system
    cat <<'END'

Next:
  1. Write your camera, pins and rules into /etc/stadimeter/appliance.toml
  2. Write your pins and your base into /etc/stadimeter/safe-outputs.conf
  3. sudo /opt/stadimeter/bin/stadimeter check /etc/stadimeter/appliance.toml
  4. sudo systemctl enable --now stadimeter; journalctl -fu stadimeter
END
fi
