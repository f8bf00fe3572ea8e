#!/usr/bin/env bash
# Generates clients from openapi/openapi.json with two generators; each goes the whole way of a job against a running service.
#     checks/clients/run.sh WANDLESS WORK
# WORK: an empty or missing folder. Needs python3 with venv, Node.js with npm, and the package registries.
set -euo pipefail
wandless="$(realpath "$1")"
mkdir -p "$2"
work="$(realpath "$2")"
here="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"
description="$here/../../openapi/openapi.json"

"$wandless" serve --listen 127.0.0.1:0 --data "$work/data" >"$work/address" 2>"$work/log" &
service=$!
trap 'kill $service 2>/dev/null; wait $service 2>/dev/null || true' EXIT
"$wandless" simulate --people 2 --views 3 --frames 40 --seed 3 --out "$work/take" >/dev/null
until grep -q http "$work/address"; do kill -0 $service; sleep 0.1; done
server="$(grep -o 'http://[^ ]*' "$work/address")"

python3 -m venv "$work/python"
"$work/python/bin/pip" install --quiet openapi-python-client ruff
export PATH="$work/python/bin:$PATH"
cd "$work"
openapi-python-client generate --path "$description" --config "$here/python.yaml" --output-path "$work/generated" --overwrite 2>&1 |
    tee generator.txt | grep -E '^(WARNING|ERROR)|^Unable' || true
pip install --quiet "$work/generated"
python3 "$here/journey.py" "$server" "$work/take"
echo "openapi-python-client: passed"

mkdir -p typescript && cd typescript
cp "$here/journey.ts" "$here/package.json" "$here/tsconfig.json" .
npm install --no-audit --no-fund --silent
npx openapi-typescript "$description" --default-non-nullable=false -o wandless.d.ts >/dev/null
npx tsc
node journey.js "$server" "$work/take"
echo "openapi-typescript: passed"
