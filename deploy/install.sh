#!/bin/sh
# Install cellctl as a service on a line IPC (Debian 12 or later), or bring an installed one up to this checkout.
#
#   sudo deploy/install.sh                  packages come from the package index
#   sudo deploy/install.sh --wheels DIR     packages come from DIR, for a line without Internet
#
# It may be run again at any time. Settings in /etc/cellctl and data in /var/lib/cellctl are never overwritten, and the
# service is neither started nor restarted: that is a person's decision.
# With DESTDIR set it only lays the files out below that folder, for building a package.
set -eu

here=$(cd "$(dirname "$0")" && pwd)
checkout=$(dirname "$here")
lock=$checkout/deploy/requirements.lock
venv=/opt/cellctl/venv
etc=${DESTDIR:-}/etc

refuse() {
    echo "install.sh: $*" >&2
    exit 1
}

read_arguments() {
    wheels=
    while [ $# -gt 0 ]; do
        case $1 in
        --wheels) wheels=$(cd "${2:?a folder is missing after --wheels}" && pwd) && shift 2 ;;
        *) refuse "unknown argument $1 (see the head of this file)" ;;
        esac
    done
}

check_machine() {
    [ "$(id -u)" = 0 ] || refuse "must be run as root, for instance: sudo $0"
    [ -f "$lock" ] || refuse "$lock is missing: this is not a whole checkout"
    command -v systemctl >/dev/null || refuse "there is no systemd on this machine"
    python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null ||
        refuse "needs python3, version 3.11 or later"
    case $(python3 -c 'import os, sys; print(os.path.realpath(sys.executable))') in
    /home/* | /root/*) refuse "python3 is installed in a home folder, where the service may not look; use Debian's" ;;
    esac
    python3 -c 'import ensurepip' 2>/dev/null || refuse "needs: apt-get install python3-venv"
    ldconfig -p | grep -q 'libaravis-0\.8\.so\.0' || refuse "needs: apt-get install libaravis-0.8-0"
}

make_user() {
    getent passwd cellctl >/dev/null && return
    useradd --system --user-group --home-dir /var/lib/cellctl --no-create-home --shell /usr/sbin/nologin cellctl
}

install_program() {
    if [ -n "$wheels" ]; then
        export PIP_NO_INDEX=1 PIP_FIND_LINKS="$wheels"
    fi
    export PIP_DISABLE_PIP_VERSION_CHECK=1
    python3 -m venv "$venv"
    "$venv/bin/python" -m pip install --quiet --no-deps --require-hashes --only-binary :all: --requirement "$lock"
    copy=$(mktemp -d)
    trap 'rm -rf "$copy"' EXIT
    for part in pyproject.toml README.md cellctl drivers simulators; do
        cp -R "$checkout/$part" "$copy/"
    done
    mkdir "$copy/deploy" && cp -R "$here/plc" "$copy/deploy/"
    "$venv/bin/python" -m pip install --quiet --no-deps --force-reinstall "$copy"
}

lay_out_files() {
    install -d -m 755 "$etc/cellctl" "$etc/cellctl/recipes" "$etc/systemd/system" "$etc/sysctl.d" "$etc/udev/rules.d"
    keep_or_put "$here/cell.toml" "$etc/cellctl/cell.toml"
    for recipe in "$checkout"/recipes/*.toml; do
        keep_or_put "$recipe" "$etc/cellctl/recipes/$(basename "$recipe")"
    done
    install -m 644 "$here/cellctl.service" "$etc/systemd/system/cellctl.service"
    install -m 644 "$here/90-cellctl.sysctl.conf" "$etc/sysctl.d/90-cellctl.conf"
    install -m 644 "$here/99-cellctl.rules" "$etc/udev/rules.d/99-cellctl.rules"
}

# A settings file that is there belongs to the people of the line.
keep_or_put() {
    [ -e "$2" ] || install -m 644 "$1" "$2"
}

# The service may talk to the addresses of cell.toml only.
write_network_rule() {
    rule=/etc/systemd/system/cellctl.service.d/cell-network.conf
    # What python prints on a mistake are the lines that tell what is wrong in cell.toml.
    addresses=$("$venv/bin/python" - /etc/cellctl/cell.toml <<'PYTHON'
import sys
from pathlib import Path

from cellctl.config import load_config
from cellctl.strict_toml import SettingsError

try:
    print(*load_config(Path(sys.argv[1])).addresses)
except SettingsError as error:
    sys.exit(str(error))
PYTHON
    ) || refuse "correct cell.toml and run this again; the service cannot reach its devices before"
    install -d -m 755 "$(dirname "$rule")"
    printf '# Written by install.sh from cell.toml.\n[Service]\nIPAddressAllow=%s\n' "$addresses" >"$rule"
}

activate() {
    systemctl daemon-reload
    systemctl enable --quiet cellctl.service
    sysctl --quiet --load /etc/sysctl.d/90-cellctl.conf
    udevadm control --reload
}

read_arguments "$@"
if [ -n "${DESTDIR:-}" ]; then
    lay_out_files
    exit
fi
check_machine
make_user
install_program
lay_out_files
write_network_rule
activate
echo "cellctl is installed. Next: edit /etc/cellctl/cell.toml, run this again, then: systemctl start cellctl"
