//! Tests of the body against the survey and against published segment masses.

use nalgebra::Vector3;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use std::collections::BTreeMap;
use wandless::body::surface::Surface;
use wandless::body::{Betas, BodyModel, default_body};

fn height(vertices: &[Vector3<f64>]) -> f64 {
    let ys = || vertices.iter().map(|v| v.y);
    ys().fold(f64::MIN, f64::max) - ys().fold(f64::MAX, f64::min)
}

/// Water's density; that of bodies is 0.985 to 1.01.
fn mass(surface: &Surface, vertices: &[Vector3<f64>]) -> f64 {
    1000.0 * surface.volume(vertices)
}

/// Length of the outline at height y, of the part with x > `from`.
pub(crate) fn girth(surface: &Surface, y: f64, from: f64) -> f64 {
    let mut total = 0.0;
    for face in &surface.faces {
        let corners = face.map(|v| surface.vertices[v]);
        let mut crossings = Vec::new();
        for k in 0..3 {
            let (a, b) = (corners[k], corners[(k + 1) % 3]);
            if (a.y < y) != (b.y < y) {
                crossings.push(a.lerp(&b, (y - a.y) / (b.y - a.y)));
            }
        }
        if let [a, b] = crossings[..] {
            total += if a.x + b.x > 2.0 * from { (a - b).norm() } else { 0.0 };
        }
    }
    total
}

/// Means of ANSUR II, men and women half and half.
#[test]
fn the_mean_body_has_the_surveys_measures() {
    let model = default_body();
    let surface = &model.surface;
    let mass = mass(surface, &surface.vertices);
    println!("stature {:.4} m, mass {mass:.1} kg", height(&surface.vertices));
    assert!((height(&surface.vertices) - 1.692).abs() < 0.005);
    assert!((mass - 76.6).abs() < 4.0);
    let (whole, left) = (f64::MIN, 0.0);
    for (name, y, from, measured) in [
        ("head", 1.600, whole, 0.568),
        ("chest", 1.231, whole, 1.003),
        ("waist", 1.018, whole, 0.901),
        ("buttock", 0.861, whole, 1.020),
        ("thigh", 0.775, left, 0.621),
        ("lower thigh", 0.533, left, 0.405),
        ("calf", 0.337, left, 0.383),
        ("ankle", 0.105, left, 0.2225),
    ] {
        let girth = girth(surface, y, from);
        println!("{name}: {girth:.3} m, {measured} measured");
        assert!((girth / measured - 1.0).abs() <= 0.03, "{name}: {girth}");
    }
}

/// Volume of a body part by columns of 4 mm along z, to 1 %: columns where `is_inside` holds at their x and y, weighted by
/// the skin weights of `joints` if any are given.
fn part_volume(model: &BodyModel, joints: &[usize], is_inside: &dyn Fn(f64, f64) -> bool) -> f64 {
    const CELL: f64 = 0.004;
    let surface = &model.surface;
    let share = |v: usize| match joints {
        [] => 1.0,
        joints => surface.skin[v].iter().filter(|s| joints.contains(&s.joint)).map(|s| s.weight).sum::<f64>(),
    };
    let mut columns: BTreeMap<(i64, i64), Vec<(f64, f64)>> = BTreeMap::new();
    for face in &surface.faces {
        let corners = face.map(|v| surface.vertices[v]);
        let range = |axis: usize| {
            let values = corners.map(|c| c[axis]);
            let low = values.iter().copied().fold(f64::MAX, f64::min);
            (low / CELL).floor() as i64..=(values.iter().copied().fold(f64::MIN, f64::max) / CELL).ceil() as i64
        };
        for (ix, iy) in range(0).flat_map(|ix| range(1).map(move |iy| (ix, iy))) {
            let (x, y) = ((ix as f64 + 0.5) * CELL, (iy as f64 + 0.5) * CELL);
            let area =
                |p: usize, q: usize| (corners[p].x - x) * (corners[q].y - y) - (corners[p].y - y) * (corners[q].x - x);
            let parts = [area(1, 2), area(2, 0), area(0, 1)];
            let sum: f64 = parts.iter().sum();
            let is_crossed = sum != 0.0 && (parts.iter().all(|p| *p >= 0.0) || parts.iter().all(|p| *p <= 0.0));
            if is_crossed && is_inside(x, y) {
                let mix = |f: [f64; 3]| (parts[0] * f[0] + parts[1] * f[1] + parts[2] * f[2]) / sum;
                columns.entry((ix, iy)).or_default().push((mix(corners.map(|c| c.z)), mix(face.map(share))));
            }
        }
    }
    let mut total = 0.0;
    for crossings in columns.values_mut() {
        crossings.sort_by(|a, b| a.0.total_cmp(&b.0));
        let spans = crossings.chunks_exact(2).map(|pair| (pair[1].0 - pair[0].0) * 0.5 * (pair[0].1 + pair[1].1));
        total += spans.sum::<f64>() * CELL * CELL;
    }
    total
}

/// De Leva 1996, men and women averaged, % of the whole. His thigh ends at a plane through the crotch and the front
/// iliac spine, 37 degrees from the midplane; shank and thigh part at the knee.
#[test]
fn segment_masses_match_published_shares() {
    let model = default_body();
    let whole = model.surface.volume(&model.surface.vertices);
    let is_above_hips = |x: f64, y: f64| y > 0.81 + x.abs() * 1.327;
    let arms = [16, 18, 20, 22];
    let arm = part_volume(&model, &arms, &|x, _| x > 0.0);
    let thigh = part_volume(&model, &[], &|x, y| x > 0.0 && y > 0.479 && !is_above_hips(x, y) && x < 0.3);
    let shank = part_volume(&model, &[], &|x, y| x > 0.0 && y <= 0.479 && y > 0.068);
    let foot = part_volume(&model, &[], &|x, y| x > 0.0 && y <= 0.068);
    for (name, volume, published, tolerance) in [
        ("head and trunk", whole - 2.0 * (arm + thigh + shank + foot), 49.8, 4.0),
        ("thigh", thigh, 14.5, 1.5),
        ("shank", shank, 4.6, 1.5),
        ("arm", arm, 4.7, 1.5),
    ] {
        let share = 100.0 * volume / whole;
        println!("{name}: {share:.2} %, {published} published");
        assert!((share - published).abs() <= tolerance, "{name}: {share}");
    }
}

#[test]
fn beta_0_is_stature_and_beta_1_is_mass() {
    let model = default_body();
    let vertices = |betas: &Betas| model.surface.shaped(betas);
    let mean = height(&vertices(&Betas::zeros()));
    for k in 0..10 {
        let change = height(&vertices(&Betas::ith(k, 1.0))) - mean;
        let (expected, tolerance) = if k == 0 { (0.092, 0.005) } else { (0.0, 0.005) };
        assert!((change - expected).abs() <= tolerance, "beta {k}: {change}");
    }
    let masses: Vec<f64> = (-3..=3).map(|b| mass(&model.surface, &vertices(&Betas::ith(1, f64::from(b))))).collect();
    println!("mass by beta 1: {masses:.1?}");
    assert!(masses.windows(2).all(|pair| pair[0] < pair[1]));
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(8);
    for _ in 0..200 {
        let direction = Betas::from_fn(|_, _| StandardNormal.sample(&mut rng));
        let shaped = vertices(&(direction * (3.0 / direction.norm())));
        let (height, mass) = (height(&shaped), mass(&model.surface, &shaped));
        assert!((1.35..=2.05).contains(&height) && (35.0..=150.0).contains(&mass), "{height} m, {mass} kg");
    }
}

/// The survey: SD 92 mm and 15.5 kg, correlation 0.69.
#[test]
fn drawn_bodies_vary_as_the_population() {
    let model = default_body();
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(9);
    let drawn: Vec<[f64; 2]> = (0..1000)
        .map(|_| {
            let shaped = model.surface.shaped(&Betas::from_fn(|_, _| StandardNormal.sample(&mut rng)));
            [height(&shaped), mass(&model.surface, &shaped)]
        })
        .collect();
    let n = drawn.len() as f64;
    let mean = [0, 1].map(|i| drawn.iter().map(|d| d[i]).sum::<f64>() / n);
    let moment = |i: usize, j: usize| drawn.iter().map(|d| (d[i] - mean[i]) * (d[j] - mean[j])).sum::<f64>() / n;
    let (stature, mass) = (moment(0, 0).sqrt(), moment(1, 1).sqrt());
    let correlation = moment(0, 1) / stature / mass;
    println!("stature SD {:.1} mm, mass SD {mass:.1} kg, correlation {correlation:.2}", stature * 1e3);
    assert!((stature - 0.092).abs() <= 0.006 && (mass - 15.5).abs() <= 3.0);
    assert!((0.5..=0.75).contains(&correlation));
}
