#!/usr/bin/env bash
# Opens every export with an independent reader: run.sh WANDLESS WORK [SESSION...]; see checks/README.md.
set -euo pipefail
wandless=$(realpath "$1")
work=$2
here=$(realpath "$(dirname "$0")")
python=${PYTHON:-python3}
blender_python=${BLENDER_PYTHON:-$python}
formats=smpl_npz,easymocap,glb,bvh,fbx,usd,trc,c3d,joint_angles,opencv_yaml,calib_toml,anipose_toml,colmap,chan,blender
failed=0

# Runs a script of Blender, if there is one: scene SCRIPT ARGUMENT...
in_blender() {
    local script=$1
    shift
    if command -v blender > /dev/null; then
        blender --background --factory-startup --python-exit-code 1 --python "$script" -- "$@"
    elif "$blender_python" -c 'import bpy' 2> /dev/null; then
        "$blender_python" "$script" -- "$@"
    else
        echo "skipped: blender is not installed"
    fi
}

# Every format of a session's result with this up axis: exported and opened.
check_session() {
    local session=$1 up=$2 name
    name=$(basename "$session")_$up
    local result=$work/result_$name exports=$work/exports_$name
    echo "== $name"
    echo "{\"up_axis\": \"$up\", \"exports\": []}" > "$work/options_$name.json"
    "$wandless" reconstruct "$session" --out "$result" --options "$work/options_$name.json" > "$work/$name.log" 2>&1 || [ $? = 3 ]
    "$python" "$here/crooked.py" "$result"
    "$python" "$here/vertices.py" "$result" "$work/body.npz"
    "$wandless" export "$result" --to "$formats" --out "$exports" > /dev/null 2>> "$work/$name.log"
    for check in amass usd points markers angles colmap opencv; do
        "$python" "$here/$check.py" "$result" "$exports" || failed=1
    done
    for check in gltf fbx; do
        NODE_MODULES=$(realpath "${NODE_MODULES:-node_modules}") node "$here/$check.mjs" "$result" "$exports" || failed=1
    done
    in_blender "$here/blender.py" "$result" "$exports" | grep -E '^(ok|FAILED|skipped)|Error' || failed=1
    if [ -n "${PICTURES:-}" ]; then
        mkdir -p "$PICTURES"
        in_blender "$here/render.py" "$result" "$exports" "$(realpath "$PICTURES")/$name" | grep -E '^(ok|FAILED|skipped)|Error' || failed=1
        "$python" "$here/plot.py" "$result" "$exports" "$PICTURES/$name" || failed=1
    fi
}

mkdir "$work"
"$wandless" simulate --out "$work/simulated" --seed 3 --people 2 --views 6 --frames 90 > /dev/null
"$wandless" simulate --out "$work/dance" --seed 1 --dance --views 5 --frames 240 > /dev/null
"$wandless" simulate --out "$work/hands" --seed 3 --people 2 --views 6 --frames 90 --convention coco_wholebody133 > /dev/null
"$wandless" body export --out "$work/body.npz"
for session in "$work/simulated" "$work/dance" "$work/hands" "${@:3}"; do
    for up in y z; do check_session "$session" "$up"; done
done
exit $failed
