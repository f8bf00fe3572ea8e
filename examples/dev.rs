use nalgebra::*;
use serde_json::Value;
use std::time::Instant as Clock;
use wandless::body::skeleton::KeypointConvention;
use wandless::geometry::*;
use wandless::pipeline::*;
use wandless::session::recording::*;
fn f(v: &Value) -> f64 {
    v.as_f64().unwrap()
}
fn load(dir: &str, null_ids: bool) -> Session {
    let s: Value = serde_json::from_str(&std::fs::read_to_string(format!("{dir}/session.json")).unwrap()).unwrap();
    let conv = KeypointConvention::parse(s["keypoint_convention"].as_str().unwrap()).unwrap();
    let n = s["n_frames"].as_u64().unwrap() as usize;
    let first = s["first_frame"].as_i64().unwrap_or(0);
    let mut views = vec![];
    for c in s["cameras"].as_array().unwrap() {
        let k = |i: usize, j: usize| f(&c["K"][i][j]);
        let id = c["id"].as_str().unwrap().to_string();
        let mut d = [0.0; 5];
        for (i, v) in c["dist"].as_array().unwrap().iter().enumerate() {
            d[i] = f(v)
        }
        let intrinsics = Intrinsics {
            width: c["width"].as_u64().unwrap() as u32,
            height: c["height"].as_u64().unwrap() as u32,
            fx: k(0, 0),
            fy: k(1, 1),
            cx: k(0, 2),
            cy: k(1, 2),
            skew: 0.0,
            dist: d,
        };
        let p: Value =
            serde_json::from_str(&std::fs::read_to_string(format!("{dir}/poses/{id}.json")).unwrap()).unwrap();
        let mut frames = vec![vec![]; n];
        let mut delivered = vec![];
        for fr in p["frames"].as_array().unwrap() {
            let fi = (fr["frame"].as_i64().unwrap() - first) as usize;
            delivered.push(FrameIndex(fi));
            for pe in fr["people"].as_array().unwrap() {
                frames[fi].push(Detection {
                    track_id: if null_ids { None } else { pe["track_id"].as_i64() },
                    keypoints: pe["keypoints"]
                        .as_array()
                        .unwrap()
                        .iter()
                        .map(|q| Keypoint { pixel: Vector2::new(f(&q[0]), f(&q[1])), confidence: f(&q[2]).min(1.0) })
                        .collect(),
                })
            }
        }
        views.push(View { id, intrinsics, camera_from_world: None, frames, delivered });
    }
    Session {
        name: dir.into(),
        fps: f(&s["fps"]),
        first_frame: first,
        n_frames: n,
        convention: conv,
        up_axis: None,
        views,
    }
}
fn truth(dir: &str, s: &Session) -> Vec<Rigid> {
    let t: Value = serde_json::from_str(&std::fs::read_to_string(format!("{dir}/gt/cameras.json")).unwrap()).unwrap();
    s.views
        .iter()
        .map(|v| {
            let c = t.as_array().unwrap().iter().find(|c| c["id"].as_str().unwrap() == v.id).unwrap();
            Rigid {
                rotation: Matrix3::from_fn(|i, j| f(&c["R"][i][j])),
                translation: Vector3::from_fn(|i, _| f(&c["t"][i])),
            }
        })
        .collect()
}
fn umeyama(a: &[Vector3<f64>], b: &[Vector3<f64>]) -> Similarity {
    let n = a.len() as f64;
    let ma = a.iter().sum::<Vector3<f64>>() / n;
    let mb = b.iter().sum::<Vector3<f64>>() / n;
    let mut m = Matrix3::zeros();
    let mut va = 0.0;
    for (x, y) in a.iter().zip(b) {
        m += (y - mb) * (x - ma).transpose();
        va += (x - ma).norm_squared();
    }
    let svd = m.svd(true, true);
    let (u, vt) = (svd.u.unwrap(), svd.v_t.unwrap());
    let mut d = Matrix3::identity();
    if (u * vt).determinant() < 0.0 {
        d[(2, 2)] = -1.0
    }
    let r = u * d * vt;
    let s = (Matrix3::from_diagonal(&svd.singular_values) * d).trace() / va;
    Similarity { scale: s, rotation: r, translation: mb - r * ma * s }
}
fn main() {
    let a: Vec<String> = std::env::args().collect();
    if a[1] == "rigs" {
        return rigs(&a);
    }
    let dir = &a[1];
    let n: u64 = a.get(2).map_or(1, |x| x.parse().unwrap());
    let session = load(dir, true);
    let gt = truth(dir, &session);
    for seed in 0..n {
        let options = Options { seed, ..Options::default() };
        let t0 = Clock::now();
        let capture = Capture::new(&session, &options);
        let p = wandless::progress::Progress::silent();
        let c = calibration::estimate_cameras(&capture, &p).unwrap();
        let dt = t0.elapsed().as_secs_f64();
        let ids: Vec<usize> = (0..gt.len()).filter(|&i| c.cameras[i].is_some()).collect();
        if ids.len() < 3 {
            println!("seed {seed}: only {} cameras", ids.len());
            continue;
        }
        let x: Vec<_> = ids.iter().map(|&i| c.cameras[i].unwrap().center()).collect();
        let y: Vec<_> = ids.iter().map(|&i| gt[i].center()).collect();
        let s = umeyama(&x, &y);
        let mut pe = 0.0;
        let mut ae = 0.0;
        for &i in &ids {
            let m = s.move_camera(&c.cameras[i].unwrap());
            pe += (m.center() - gt[i].center()).norm();
            ae += rotation::angle_between(&m.rotation, &gt[i].rotation).to_degrees();
        }
        println!(
            "seed {seed}: {} cams  {:.1} mm {:.3} deg scale {:.4} explained {:.3} people {} noise {:.2} rivals {:.2?} t={:.2}s tracks {:?}",
            ids.len(),
            1e3 * pe / ids.len() as f64,
            ae / ids.len() as f64,
            s.scale,
            c.association.explained,
            c.association.tracks.len(),
            c.noise,
            c.rivals,
            dt,
            c.association.tracks.iter().map(|t| t.detections.iter().flatten().flatten().count()).collect::<Vec<_>>()
        );
        if std::env::var("V").is_ok() {
            for s in &c.stages {
                println!(
                    "   {} it {} {:?}->{:?} {} {:?}",
                    s.stage, s.iterations, s.cost_before, s.cost_after, s.termination, s.metrics
                )
            }
        }
        if std::env::var("H").is_ok() {
            let t = Clock::now();
            println!(
                "  heldout {:?} fixed {:?} {:.2}s",
                calibration::heldout_px(&capture, &c, bundle_adjustment::CameraFreedom::Adjusted, &p).unwrap(),
                {
                    let g = calibration::from_given_cameras(
                        &capture,
                        gt.iter().map(|g| Some(*g)).collect(),
                        bundle_adjustment::CameraFreedom::Held,
                        &p,
                    )
                    .unwrap();
                    calibration::heldout_px(&capture, &g, bundle_adjustment::CameraFreedom::Held, &p).unwrap()
                },
                t.elapsed().as_secs_f64()
            );
        }
    }
}

fn rigs(a: &[String]) {
    let (lo, hi): (u64, u64) = (a[2].parse().unwrap(), a[3].parse().unwrap());
    let (mut fails, mut n) = (0, 0);
    for i in lo..hi {
        let cfg = wandless::simulation::config::random_rig_config(i);
        let sim = wandless::simulation::simulate(&cfg).unwrap();
        let session = &sim.session;
        let gt = &sim.truth.cameras;
        let options = Options { seed: i, ..Options::default() };
        let t0 = Clock::now();
        let capture = Capture::new(session, &options);
        let p = wandless::progress::Progress::silent();
        let c = calibration::estimate_cameras(&capture, &p).unwrap();
        let dt = t0.elapsed().as_secs_f64();
        let mut worst: f64 = 0.0;
        let v = gt.len();
        for x in 0..v {
            for y in 0..x {
                match (c.cameras[x], c.cameras[y]) {
                    (Some(ca), Some(cb)) => {
                        let rel = cb * ca.inverse();
                        let g = gt[y] * gt[x].inverse();
                        worst = worst.max(rotation::angle_between(&rel.rotation, &g.rotation).to_degrees());
                        worst = worst.max(rel.translation.angle(&g.translation).to_degrees());
                    }
                    _ => worst = worst.max(180.0),
                }
            }
        }
        let u = c.adjusted.as_ref().map(|a| {
            a.cameras.iter().filter_map(|c| c.uncertainty).map(|u| u.sigma_angle.to_degrees()).fold(0.0, f64::max)
        });
        n += 1;
        if worst > 5.0 {
            fails += 1
        }
        println!(
            "{} rig {i}: views {} people {} worst {:.2} deg, sigma {:.2?} explained {:.3} placed {} found {} rivals {:.2?} noise {:.2} t={:.2}",
            if worst > 5.0 { "FAIL" } else { "ok  " },
            v,
            cfg.people,
            worst,
            u,
            c.association.explained,
            c.cameras.iter().flatten().count(),
            c.association.tracks.len(),
            c.rivals,
            c.noise,
            dt
        );
    }
    println!("{fails} of {n} failed");
}
