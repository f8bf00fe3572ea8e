#!/usr/bin/env bash
# Opens every export with an independent reader: run.sh WANDLESS WORK; see checks/README.md.
set -euo pipefail
wandless=$(realpath "$1")
work=$2
here=$(realpath "$(dirname "$0")")
python=${PYTHON:-python3}
formats=smpl_npz,easymocap,glb,bvh,fbx,usd,trc,c3d,joint_angles,opencv_yaml,calib_toml,anipose_toml,colmap,chan,blender

mkdir "$work"
"$wandless" simulate --out "$work/session" --seed 3 --people 2 --views 6 --frames 90
"$wandless" body export --out "$work/body.npz"
failed=0
for up in y z; do
    result=$work/result_$up
    exports=$work/exports_$up
    echo "{\"up_axis\": \"$up\", \"exports\": []}" > "$work/options_$up.json"
    "$wandless" reconstruct "$work/session" --out "$result" --options "$work/options_$up.json"
    "$python" "$here/crooked.py" "$result"
    "$python" "$here/vertices.py" "$result" "$work/body.npz"
    "$wandless" export "$result" --to "$formats" --out "$exports" > /dev/null
    for check in amass usd points markers angles colmap opencv; do
        "$python" "$here/$check.py" "$result" "$exports" || failed=1
    done
    for check in gltf fbx; do
        NODE_MODULES=$(realpath "${NODE_MODULES:-node_modules}") node "$here/$check.mjs" "$result" "$exports" || failed=1
    done
    if command -v blender > /dev/null; then
        blender --background --factory-startup --python-exit-code 1 --python "$here/blender.py" -- \
            "$result" "$exports" | grep -E '^(ok|FAILED|skipped)|Error' || failed=1
    elif "$python" -c 'import bpy' 2> /dev/null; then
        "$python" "$here/blender.py" -- "$result" "$exports" | grep -E '^(ok|FAILED|skipped)|Error' || failed=1
    else
        echo "skipped: blender is not installed"
    fi
done
exit $failed
