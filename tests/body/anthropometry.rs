//! M6 to M9: the body against the survey and against published segment masses.

use nalgebra::Vector3;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
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
fn girth(surface: &Surface, y: f64, from: f64) -> f64 {
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

/// M6. Means of ANSUR II, men and women half and half.
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

/// Volume that each joint carries, weight by weight: signed tetrahedra shared out by the corners' skin weights.
///
/// Tetrahedra from the origin are closed only as a whole, so each joint's part is closed at its own joint: a face's
/// share counts from the joint that carries it, and what the cuts between neighbours leave out is small.
fn carried_volume(model: &BodyModel, joints: &[usize]) -> f64 {
    let surface = &model.surface;
    let mut total = 0.0;
    // A grid over the inside would be exact; columns of 4 mm by the signed crossings along x are good to 1 %.
    const CELL: f64 = 0.004;
    let mut columns: std::collections::BTreeMap<(i64, i64), Vec<(f64, f64)>> = Default::default();
    for face in &surface.faces {
        let corners = face.map(|v| surface.vertices[v]);
        let share =
            |v: usize| surface.skin[v].iter().filter(|s| joints.contains(&s.joint)).map(|s| s.weight).sum::<f64>();
        let range = |axis: usize| {
            let values = corners.map(|c| c[axis]);
            let low = (values.iter().copied().fold(f64::MAX, f64::min) / CELL).floor() as i64;
            (low, (values.iter().copied().fold(f64::MIN, f64::max) / CELL).ceil() as i64)
        };
        let ((y0, y1), (x0, x1)) = (range(1), range(0));
        for iy in y0..=y1 {
            for ix in x0..=x1 {
                let (x, y) = ((ix as f64 + 0.5) * CELL, (iy as f64 + 0.5) * CELL);
                let area = |p: &Vector3<f64>, q: &Vector3<f64>| (p.x - x) * (q.y - y) - (p.y - y) * (q.x - x);
                let parts =
                    [area(&corners[1], &corners[2]), area(&corners[2], &corners[0]), area(&corners[0], &corners[1])];
                let sum: f64 = parts.iter().sum();
                if parts.iter().all(|p| *p >= 0.0) || parts.iter().all(|p| *p <= 0.0) {
                    let mix = |f: [f64; 3]| (parts[0] * f[0] + parts[1] * f[1] + parts[2] * f[2]) / sum;
                    if sum != 0.0 {
                        let crossing = (mix(corners.map(|c| c.z)), mix(face.map(share)));
                        columns.entry((ix, iy)).or_default().push(crossing);
                    }
                }
            }
        }
    }
    for crossings in columns.values_mut() {
        crossings.sort_by(|a, b| a.0.total_cmp(&b.0));
        for pair in crossings.chunks_exact(2) {
            total += (pair[1].0 - pair[0].0) * 0.5 * (pair[0].1 + pair[1].1) * CELL * CELL;
        }
    }
    total
}

/// M7. De Leva 1996, men and women averaged, % of the whole.
#[test]
fn segments_have_their_published_shares() {
    let model = default_body();
    let whole = model.surface.volume(&model.surface.vertices);
    for (name, joints, published, tolerance) in [
        ("head and trunk", &[0, 3, 6, 9, 12, 13, 14, 15][..], 49.8, 4.0),
        ("thigh", &[1][..], 14.5, 1.5),
        ("shank", &[4][..], 4.6, 1.5),
        ("arm", &[16, 18, 20, 22][..], 4.7, 1.5),
    ] {
        let share = 100.0 * carried_volume(&model, joints) / whole;
        println!("{name}: {share:.2} %, {published} published");
        assert!((share - published).abs() <= tolerance, "{name}: {share}");
    }
}

/// M8.
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

/// M9. The survey: SD 92 mm and 15.5 kg, correlation 0.69.
#[test]
fn drawn_bodies_spread_as_the_population_does() {
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
