use super::*;

fn camera(dist: Distortion) -> Intrinsics {
    Intrinsics { width: 1920, height: 1080, fx: 1100.0, fy: 1090.0, cx: 950.0, cy: 545.0, skew: 0.7, dist }
}

/// None, mild, the strong barrel of a wide lens with tangential terms, the rational model, and two fisheyes.
const LENSES: [Distortion; 7] = [
    Distortion::None,
    Distortion::OpenCv5([-0.05, 0.01, 0.0, 0.0, 0.0]),
    Distortion::OpenCv5([0.12, -0.2, -0.001, 0.002, 0.08]),
    Distortion::OpenCv5([-0.28, 0.09, 0.0007, -0.0004, -0.012]),
    Distortion::Rational8([0.6, 0.1, 0.0005, -0.0003, 0.01, 0.75, 0.2, 0.02]),
    Distortion::Fisheye4([0.0; 4]),
    Distortion::Fisheye4([-0.03, 0.012, -0.006, 0.001]),
];

#[test]
fn a_point_on_the_axis_lies_on_the_principal_point() {
    for dist in LENSES {
        assert_eq!(camera(dist).pixel_from_camera(&Vector3::new(0.0, 0.0, 3.0)), Some(Vector2::new(950.0, 545.0)));
    }
}

#[test]
fn distortion_follows_opencvs_formula() {
    // By hand at x = 0.5, y = 0.2: r2 = 0.29.
    let [k1, k2, p1, p2, k3] = [0.1, -0.05, 0.001, 0.002, 0.01];
    let radial = 1.0 + k1 * 0.29 + k2 * 0.0841 + k3 * 0.024389;
    let x = 0.5 * radial + 2.0 * p1 * 0.1 + p2 * (0.29 + 0.5);
    let y = 0.2 * radial + p1 * (0.29 + 0.08) + 2.0 * p2 * 0.1;
    let pixel = camera([k1, k2, p1, p2, k3].into()).pixel_from_normalized(&Vector2::new(0.5, 0.2));
    assert!((pixel - Vector2::new(1100.0 * x + 0.7 * y + 950.0, 1090.0 * y + 545.0)).norm() < 1e-11);
}

#[test]
fn the_rational_model_without_a_denominator_is_the_polynomial() {
    let [k1, k2, p1, p2, k3] = [-0.28, 0.09, 0.0007, -0.0004, -0.012];
    let (short, long) =
        (Distortion::OpenCv5([k1, k2, p1, p2, k3]), Distortion::Rational8([k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]));
    for n in [Vector2::new(0.5, 0.2), Vector2::new(-0.7, 0.6)] {
        assert_eq!(camera(short).pixel_from_normalized(&n), camera(long).pixel_from_normalized(&n));
    }
}

#[test]
fn an_ideal_fisheye_measures_the_angle() {
    // 60 degrees to the right: pi / 3 focal lengths from the principal point.
    let pixel = camera(Distortion::Fisheye4([0.0; 4])).pixel_from_normalized(&Vector2::new(3f64.sqrt(), 0.0));
    assert!((pixel.x - (950.0 + 1100.0 * std::f64::consts::FRAC_PI_3)).abs() < 1e-10);
    // With coefficients at theta = pi / 4, by the formula of the model.
    let (theta, k) = (std::f64::consts::FRAC_PI_4, [-0.03, 0.012, -0.006, 0.001]);
    let distorted =
        theta * (1.0 + k[0] * theta.powi(2) + k[1] * theta.powi(4) + k[2] * theta.powi(6) + k[3] * theta.powi(8));
    let pixel = camera(Distortion::Fisheye4(k)).pixel_from_normalized(&Vector2::new(0.0, 1.0));
    assert!((pixel.y - (545.0 + 1090.0 * distorted)).abs() < 1e-10);
}

#[test]
fn points_behind_the_camera_do_not_project() {
    let camera = camera(Distortion::None);
    for z in [-1.0, 0.0, 0.5 * MIN_DEPTH] {
        let point = Vector3::new(0.1, 0.1, z);
        assert!(camera.pixel_from_camera(&point).is_none() && camera.project_with_jacobian(&point).is_none());
    }
}

#[test]
fn the_projections_derivative_agrees_with_central_differences() {
    let step = 1e-6;
    for dist in LENSES {
        let camera = camera(dist);
        for point in [
            Vector3::new(0.3, -0.2, 2.0),
            Vector3::new(-1.9, 1.0, 2.5),
            Vector3::new(1.0, 0.4, 1.2),
            Vector3::new(1e-5, -2e-5, 0.5),
        ] {
            let (pixel, jacobian) = camera.project_with_jacobian(&point).unwrap();
            assert_eq!(Some(pixel), camera.pixel_from_camera(&point));
            for axis in 0..3 {
                let mut d = Vector3::zeros();
                d[axis] = step;
                let ahead = camera.pixel_from_camera(&(point + d)).unwrap();
                let behind = camera.pixel_from_camera(&(point - d)).unwrap();
                let slope = (ahead - behind) / (2.0 * step);
                // Pixels of 1e3 are exact to 1e-13, so the difference quotient is to 1e-7.
                assert!((slope - jacobian.column(axis)).norm() < 1e-6, "{dist:?} {point} {axis}");
            }
        }
    }
}

#[test]
fn the_derivative_by_the_radial_coefficient_matches_differences() {
    for dist in LENSES {
        let camera = camera(dist);
        for point in [Vector2::new(0.3, -0.2), Vector2::new(-0.6, 0.4), Vector2::new(1e-5, 2e-5)] {
            let moved = |change: f64| camera.with_radial(change).pixel_from_normalized(&point);
            let slope = (moved(1e-6) - moved(-1e-6)) / 2e-6;
            assert!((slope - camera.by_radial(&point)).norm() < 1e-6, "{dist:?} {point}");
        }
    }
}

fn without_lens(distorted: &Intrinsics) -> Intrinsics {
    Intrinsics { dist: Distortion::None, ..*distorted }
}

#[test]
fn undistortion_comes_back_to_every_pixel_of_the_image() {
    for dist in LENSES {
        let camera = camera(dist);
        for row in (0..=1080).step_by(60) {
            for column in (0..=1920).step_by(60) {
                let pixel = Vector2::new(column as f64 - 0.5, row as f64 - 0.5);
                let again = camera.pixel_from_normalized(&camera.normalized_from_pixel(&pixel));
                assert!((again - pixel).norm() < 1e-9, "{dist:?} {pixel}: {again}");
                // Not on another branch of the polynomial: no lens here bends a ray by half of its slope. The fisheyes
                // distort_with_jacobian most, at their corners 57 degrees from the axis: (tan 1 - 1) / tan 1 is 0.36.
                let (straight, distorted) =
                    (without_lens(&camera).normalized_from_pixel(&pixel), camera.normalized_from_pixel(&pixel));
                assert!((straight - distorted).norm() < 0.5 * distorted.norm(), "{dist:?} {pixel}");
            }
        }
    }
}

/// Joints that a detector places outside the image became rays to the opposite side: beyond its fold a polynomial has other branches.
#[test]
fn keypoints_beyond_the_fold_of_a_lens_keep_their_direction() {
    // The first folds at a radius of (0.9)^-1/2; the second at 1, to rise again from the root of 2 on.
    for (k, edge) in [([-0.3, 0.0, 0.0, 0.0, 0.0], 1.054), ([-0.5, 0.1, 0.0, 0.0, 0.0], 1.0)] {
        let lens = Distortion::from(k);
        let direction = Vector2::new(0.8, -0.6);
        for (radius, inside) in [(0.3, true), (0.59, true), (0.72, false), (0.8, false), (1.0, false), (3.0, false)] {
            let found = lens.undistort(&(direction * radius));
            assert!((found.normalize() - direction).norm() < 1e-9, "{k:?} {radius}: {found}");
            assert!(found.norm() < edge && (inside || found.norm() > edge - 0.011), "{k:?} {radius}: {found}");
            let again = (lens.distorted(&found) - direction * radius).norm();
            assert_eq!(again < 1e-9, inside, "{k:?} {radius}: {again}");
        }
    }
}

#[test]
fn a_turned_camera_sees_the_turned_image() {
    for dist in LENSES {
        let given = Intrinsics { skew: 0.0, ..camera(dist) };
        let (clockwise, back) = (given.turned_clockwise().unwrap(), given.turned_counterclockwise().unwrap());
        assert_eq!([clockwise.width, clockwise.height], [1080, 1920]);
        for n in [Vector2::new(0.5, 0.2), Vector2::new(-0.3, 0.1)] {
            let p = given.pixel_from_normalized(&n);
            let turned = clockwise.pixel_from_normalized(&Vector2::new(-n.y, n.x));
            assert!((turned - Vector2::new(1079.0 - p.y, p.x)).norm() < 1e-9);
            let turned = back.pixel_from_normalized(&Vector2::new(n.y, -n.x));
            assert!((turned - Vector2::new(p.y, 1919.0 - p.x)).norm() < 1e-9);
        }
    }
    assert_eq!(camera(Distortion::None).turned_clockwise(), None, "with skew");
}
