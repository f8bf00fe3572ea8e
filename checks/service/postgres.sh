#!/usr/bin/env bash
# A temporary PostgreSQL server for tests:
#   postgres.sh find               prints the folder of its programs, or fails
#   postgres.sh run COMMAND...     runs a command with WANDLESS_TEST_POSTGRES set, and removes the server
# The server refuses to run as root; root starts it as the user 65534, which owns nothing else.
set -euo pipefail

find_programs() {
    for folder in $(ls -d /usr/lib/postgresql/*/bin 2>/dev/null | sort -Vr) ${PATH//:/ }; do
        if [ -x "$folder/initdb" ] && [ -x "$folder/pg_ctl" ]; then
            version="$("$folder/initdb" --version | grep -oE '[0-9]+' | head -1)"
            if [ "$version" -ge 15 ]; then echo "$folder"; return; fi
        fi
    done
    return 1
}

programs="$(find_programs)" || { echo "PostgreSQL 15 or newer (initdb, pg_ctl) is not installed" >&2; exit 1; }
[ "$1" = find ] && { echo "$programs"; exit 0; }
shift

place="$(mktemp -d)"
as_owner=()
if [ "$(id -u)" = 0 ]; then
    chown 65534 "$place"
    as_owner=(setpriv --reuid=65534 --clear-groups)
fi
port="$(python3 -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])')"
cd_place() { (cd "$place" && "${as_owner[@]}" "$@"); }
cd_place "$programs/initdb" -D "$place/data" -U postgres -A trust --no-sync >/dev/null
cd_place tee -a "$place/data/postgresql.conf" >/dev/null <<END
listen_addresses = '127.0.0.1'
port = $port
unix_socket_directories = '$place'
fsync = off
max_connections = 500
END
cd_place "$programs/pg_ctl" -D "$place/data" -l "$place/log" -w start >/dev/null
trap 'cd_place "$programs/pg_ctl" -D "$place/data" -m immediate stop >/dev/null; rm -rf "$place"' EXIT
WANDLESS_TEST_POSTGRES="postgres://postgres@127.0.0.1:$port/postgres" "$@"
