//! The part of `/docs` to begin with: the commands of one job, the layouts of a session, the options.

use crate::pipeline::option_reference::paragraph;
use crate::pipeline::option_table::OPTION_TABLE;

/// Commands of one job with curl, and the layouts of a session.
const COMMANDS: &str = r#"<h2>One job with curl</h2>
<pre>S=http://127.0.0.1:8700                       # with keys: add -H "Authorization: Bearer $WANDLESS_KEY" to every command

(cd take &amp;&amp; zip -qr ../take.zip .)            # a session folder; videos and images are not needed
curl -s --data-binary @take.zip -H 'Content-Type: application/zip' $S/v1/sessions
#   {"id": "session_…", "cameras": 5, "frames": 300, "format": "openpose with toml", "warnings": […], …}

curl -s $S/v1/sessions/session_…/inspection   # which cameras see the same people, before anything is solved
curl -s -H 'Content-Type: application/json' -H "Idempotency-Key: $(uuidgen)" $S/v1/jobs \
     -d '{"session": "session_…", "options": {"people": 3, "fps": 25, "exports": ["glb"]}}'
curl -s "$S/v1/jobs/job_…?wait=30"            # answers when the job has changed, after 30 s at the latest
curl -s -N $S/v1/jobs/job_…/events            # or: server-sent events until the end

curl -s $S/v1/jobs/job_…/report               # verdict, errors per camera and person
curl -s -o result.zip $S/v1/jobs/job_…/archive
curl -s -H 'Content-Type: application/json' $S/v1/jobs/job_…/exports -d '{"exports": ["bvh", "usd"]}'
curl -s -O $S/v1/jobs/job_…/artifacts/scene.glb

# Upload and job in one request:
curl -s -F session=@take.zip -F 'options={"people": 3}' $S/v1/jobs</pre>
<h2>Layouts of a session</h2>
<pre>native                              another detector, unchanged
  session.json                        Calib.toml            cameras: Pose2Sim, anipose, OpenCV YAML, COLMAP, Qualisys, …
    {"name", "fps", "n_frames",       session.json          optional: {"fps": 25}
     "keypoint_convention",           cam1/                 named as the camera in the calibration
     "cameras": [{"id", "width",        cam1_000000000000_keypoints.json
      "height", "K", "dist",            cam1_000000000001_keypoints.json
      "R"?, "t"?}]}                   cam2/…
  poses/&lt;camera id&gt;.json
    {"frames": [{"frame": 0, "people": [{"track_id": null, "keypoints": [[x, y, confidence], …]}]}]}</pre>
<p>A session is sent as a zip of such a folder, as one JSON document (<code>session.json</code> with the member
<code>poses: {"&lt;camera id&gt;": {"frames": […]}}</code>), or as NDJSON: the document without poses in the first line, then one
line <code>{"camera", "frame", "people"}</code> per camera and frame. Beside <code>keypoints</code> a person may have
<code>covariances</code>, <code>[[xx, xy, yy], …]</code> in px², or <code>sigmas</code> in px, <code>null</code> where unknown: they
count as far as the residuals confirm them. <code>keypoint_convention</code> (or the file <code>landmarks.json</code>) may be a table
of landmarks <code>{"name", "landmarks": [{"name", "terms": [{"joint", "weight", "offset": [x, y, z]}]}]}</code> that contains all
points of a convention by name.</p>
"#;

/// Text for HTML.
pub(super) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

/// The beginning of the page.
pub(super) fn guide() -> String {
    let rows = OPTION_TABLE
        .iter()
        .map(|row| format!("<tr><td><code>{}</code></td><td>{}</td></tr>\n", row.name, escaped(&paragraph(row))));
    format!("{COMMANDS}<h2>Options of a job</h2>\n<table>{}</table>\n", rows.collect::<String>())
}
