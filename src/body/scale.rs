//! Metric scale from people: what parts of their bodies measure against what adults' measure, and against one known
//! stature.
//!
//! Shoulder and hip widths are left out: detectors place hips and shoulders by the skin.
//! The reference lengths are the default body's at beta 0 (ANSUR II and de Leva, see [`mod@super::default_body`]), men and
//! women half and half. How a detector's joints lie against these is known badly (knee and hip 30 to 50 mm off, ankle
//! 1 to 15 mm, of varying direction: Needham et al. 2021, Sci. Rep. 11:20673): no correction is made, the doubt is in
//! the interval.

use super::kinematics::{Pose, joints_by_betas, landmark_by_betas, landmark_position, posed};
use super::model::{Betas, BodyModel};
use super::segments::{MeasuredSegment, Segment};
use crate::optim::robust::INTERVAL_95;
use nalgebra::{DMatrix, DVector};

/// Part of the detector's bias that all segments share, as a log ratio.
const COMMON_BIAS: f64 = 0.01;

/// The factor from the cameras' own unit to metres.
#[derive(Debug, Clone, PartialEq)]
pub struct ScaleEstimate {
    /// Metres per unit.
    pub scale: f64,
    /// Where the true factor lies with 95 % certainty, for adults.
    pub interval95: [f64; 2],
    /// What it rests on, one sentence.
    pub evidence: String,
}

/// What one person's tape measure said.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownStature {
    /// Whose, as an index into the people.
    pub person: usize,
    /// Height, m.
    pub metres: f64,
    /// Standard deviation of its logarithm.
    pub sigma_log: f64,
}

/// Estimates the metric scale from one or more people; `None` without any measured segment.
///
/// Generalised least squares over the logarithms of all people's segments and of the stature that is known,
/// `log(reference / measured) = s + e` and `log(reference / stature) = 0 + e`. The covariance of `e` has the differences
/// between adults (from the model's betas, which are independent between people: stature and proportions), the
/// detector's bias (the same for all people), and the measurement. So a person seen well counts more, several people
/// narrow the interval down to the detector's bias and not below, and a known stature says how large a person's bones
/// are to be expected, no more. People who fit the others badly (a child, a double) are loosened by Huber's weight at 2
/// standard deviations.
pub fn scale_from_people(
    model: &BodyModel,
    people: &[Vec<MeasuredSegment>],
    known: Option<KnownStature>,
) -> Option<ScaleEstimate> {
    let mut rows = segment_rows(model, people);
    rows.extend(known.map(|known| stature_row(model, known)));
    let everybody = |looseness: &[f64]| solve_mean(&rows.iter().collect::<Vec<_>>(), looseness);
    let mut looseness = vec![1.0; people.len()];
    let mut mean = everybody(&looseness)?;
    for _ in 0..ROBUST_ROUNDS {
        for (p, looseness) in looseness.iter_mut().enumerate() {
            let own: Vec<&Row> = rows.iter().filter(|row| row.person == p).collect();
            let Some(person) = solve_mean(&own, &vec![1.0; people.len()]) else { continue };
            let distance = (person.value - mean.value).abs() / person.variance.sqrt();
            *looseness = (distance / 2.0).max(1.0);
        }
        mean = everybody(&looseness)?;
    }
    let half = INTERVAL_95 * mean.variance.sqrt();
    let n_seen = people.iter().filter(|segments| !segments.is_empty()).count();
    let n_samples: usize = people.iter().flatten().map(|segment| segment.n_samples).sum();
    let who = if n_seen == 1 { "1 person" } else { &format!("{n_seen} people") };
    let stature = known.map_or(String::new(), |known| format!(" and a height of {} m", known.metres));
    Some(ScaleEstimate {
        scale: mean.value.exp(),
        interval95: [(mean.value - half).exp(), (mean.value + half).exp()],
        evidence: format!(
            "limbs, trunks and heads of {who} ({n_samples} lengths){stature} against those of adults; between adults and by the \
             detector's habits the scale is uncertain to {:.1} %",
            100.0 * half
        ),
    })
}

/// The scale where nobody can be measured and people are taken to be average adults, as in a single view: what is as
/// tall as it looks may be small and near, or large and far. The interval is that of one adult's stature.
pub fn scale_of_nobody(model: &BodyModel) -> ScaleEstimate {
    let half = INTERVAL_95 * stature_per_beta(model).norm();
    ScaleEstimate {
        scale: 1.0,
        interval95: [(-half).exp(), half.exp()],
        evidence: format!(
            "one view: people are taken to be as large as an average adult, hence each of them and their distance from the \
             camera are uncertain to {:.0} %",
            100.0 * half
        ),
    }
}

/// Re-weightings of people; Huber's weights settle in a few.
const ROBUST_ROUNDS: usize = 5;

/// Who stands highest by what was measured: the largest expected stature, `cov(h, y) C^-1 (y - s)` (best linear
/// prediction); `None` where nobody was measured.
pub fn tallest(model: &BodyModel, people: &[Vec<MeasuredSegment>]) -> Option<usize> {
    let rows = segment_rows(model, people);
    let scale = solve_mean(&rows.iter().collect::<Vec<_>>(), &vec![1.0; people.len()])?.value;
    let per_beta = stature_per_beta(model);
    let expected = |p: usize| {
        let own: Vec<&Row> = rows.iter().filter(|row| row.person == p).collect();
        let shorter = DVector::from_iterator(own.len(), own.iter().map(|row| row.ratio - scale));
        let shared = DVector::from_iterator(own.len(), own.iter().map(|row| -row.log_per_beta.dot(&per_beta)));
        let explained = covariance(&own, &vec![1.0; people.len()]).cholesky()?.solve(&shorter);
        (!own.is_empty()).then(|| (p, shared.dot(&explained)))
    };
    (0..people.len()).filter_map(expected).max_by(|a, b| a.1.total_cmp(&b.1)).map(|(person, _)| person)
}

/// One observation, as a log ratio of what adults have on average to what this person has.
struct Row {
    person: usize,
    /// `y`.
    ratio: f64,
    /// Whether it was measured in the cameras' own unit: the coefficient of `s`.
    is_scaled: bool,
    /// Which detector's bias it shares.
    segment: Option<Segment>,
    /// Change of the person's own logarithm per beta.
    log_per_beta: Betas,
    /// Standard deviation of the measurement.
    sigma: f64,
}

fn segment_rows(model: &BodyModel, people: &[Vec<MeasuredSegment>]) -> Vec<Row> {
    let references = Segment::ALL.map(|segment| reference_segment(model, segment));
    let row = |person: usize, measured: &MeasuredSegment| {
        let reference = references[measured.segment as usize].as_ref()?;
        Some(Row {
            person,
            ratio: (reference.length / measured.length).ln(),
            is_scaled: true,
            segment: Some(measured.segment),
            log_per_beta: reference.log_per_beta,
            // 0.2 % keeps the matrix regular also for exact lengths.
            sigma: measured.sigma_log.hypot(0.002),
        })
    };
    people.iter().enumerate().flat_map(|(p, segments)| segments.iter().filter_map(move |s| row(p, s))).collect()
}

fn stature_row(model: &BodyModel, known: KnownStature) -> Row {
    Row {
        person: known.person,
        ratio: (model.surface.stature(&Betas::zeros()) / known.metres).ln(),
        is_scaled: false,
        segment: None,
        log_per_beta: stature_per_beta(model),
        sigma: known.sigma_log,
    }
}

/// Change of the stature's logarithm per beta: the difference between +1 and -1, for it is linear but for which vertex is
/// highest.
fn stature_per_beta(model: &BodyModel) -> Betas {
    let stature = |k: usize, beta: f64| {
        let mut betas = Betas::zeros();
        betas[k] = beta;
        model.surface.stature(&betas)
    };
    Betas::from_fn(|k, _| (stature(k, 1.0) / stature(k, -1.0)).ln() / 2.0)
}

/// A segment of the mean body.
struct ReferenceSegment {
    /// m.
    length: f64,
    /// Change of the length's logarithm per beta.
    log_per_beta: Betas,
}

/// `None` where the body has no landmark at one of the ends.
fn reference_segment(model: &BodyModel, segment: Segment) -> Option<ReferenceSegment> {
    let body = model.shaped(&Betas::zeros());
    let skeleton = posed(&body, &Pose::rest());
    let joints_by_betas = joints_by_betas(model, &skeleton);
    let place = |name: &str| Some(landmark_position(model, &body, &skeleton, model.landmark_index(name)?));
    let by_betas = |name: &str| {
        let landmark = &model.landmarks[model.landmark_index(name)?];
        Some(landmark_by_betas(landmark, &skeleton, &joints_by_betas))
    };
    let rest = *segment.along(place).first()?;
    let moved = |k: usize| {
        let moved = segment.along(|name| Some(by_betas(name)?.column(k).into_owned()));
        moved[0].dot(&rest) / rest.norm_squared()
    };
    Some(ReferenceSegment { length: rest.norm(), log_per_beta: Betas::from_fn(|k, _| moved(k)) })
}

fn covariance(rows: &[&Row], looseness: &[f64]) -> DMatrix<f64> {
    DMatrix::from_fn(rows.len(), rows.len(), |i, j| {
        let (a, b) = (rows[i], rows[j]);
        let mut value = 0.0;
        if let (Some(seen), Some(other)) = (a.segment, b.segment) {
            value += COMMON_BIAS * COMMON_BIAS;
            if seen == other {
                value += seen.detector_bias().powi(2);
            }
        }
        if a.person == b.person {
            value += a.log_per_beta.dot(&b.log_per_beta) * looseness[a.person];
        }
        if i == j {
            value += a.sigma * a.sigma;
        }
        value
    })
}

/// A mean and its variance.
struct Mean {
    value: f64,
    variance: f64,
}

/// `s = x^T C^-1 y / x^T C^-1 x`, variance `1 / x^T C^-1 x`, x being 1 where a row is scaled.
fn solve_mean(rows: &[&Row], looseness: &[f64]) -> Option<Mean> {
    let scaled = DVector::from_iterator(rows.len(), rows.iter().map(|row| f64::from(u8::from(row.is_scaled))));
    let ratios = DVector::from_iterator(rows.len(), rows.iter().map(|row| row.ratio));
    let weights = covariance(rows, looseness).cholesky()?.solve(&scaled);
    let total = weights.dot(&scaled);
    let value = weights.dot(&ratios) / total;
    (value.is_finite() && total > 0.0).then_some(Mean { value, variance: 1.0 / total })
}

#[cfg(test)]
mod tests {
    use super::super::default_body::default_body;
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    struct Crowd {
        measured: Vec<Vec<MeasuredSegment>>,
        statures: Vec<f64>,
    }

    /// People drawn from the population, seen by a detector drawn from its biases, in units of 1 / `scale` m.
    fn crowd(n_people: usize, scale: f64, seed: u64) -> Crowd {
        let model = default_body();
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let common = COMMON_BIAS * normal();
        let biases = Segment::ALL.map(|segment| common + segment.detector_bias() * normal());
        let betas: Vec<Betas> = (0..n_people).map(|_| Betas::from_fn(|_, _| normal())).collect();
        let measured = |betas: &Betas, segment: Segment| {
            let reference = reference_segment(&model, segment).unwrap();
            let log = reference.log_per_beta.dot(betas) + biases[segment as usize];
            MeasuredSegment { segment, length: reference.length * log.exp() / scale, sigma_log: 0.003, n_samples: 500 }
        };
        let of_person = |betas: &Betas| Segment::ALL.map(|segment| measured(betas, segment)).to_vec();
        Crowd {
            measured: betas.iter().map(of_person).collect(),
            statures: betas.iter().map(|betas| model.surface.stature(betas)).collect(),
        }
    }

    /// 95 % of 400 draws have a binomial standard deviation of 1.1 %.
    #[test]
    fn the_interval_covers_the_truth_as_often_as_it_says() {
        for (n_people, is_known) in [(1, false), (2, false), (4, false), (1, true), (3, true)] {
            let (mut covered, mut squares) = (0, 0.0);
            for seed in 0..400 {
                let crowd = crowd(n_people, 2.5, seed);
                let known = KnownStature { person: 0, metres: crowd.statures[0], sigma_log: 0.01 };
                let known = Some(known).filter(|_| is_known);
                let estimate = scale_from_people(&default_body(), &crowd.measured, known).unwrap();
                covered += usize::from(estimate.interval95[0] < 2.5 && 2.5 < estimate.interval95[1]);
                squares += (estimate.scale / 2.5).ln().powi(2);
            }
            let sd = (squares / 400.0_f64).sqrt();
            println!("{n_people} people: sd {:.2} %, covered {:.3}", sd * 100.0, covered as f64 / 400.0);
            assert!((0.91..=0.98).contains(&(covered as f64 / 400.0)));
            assert!(if is_known { 0.01..0.03 } else { 0.02..0.065 }.contains(&sd));
        }
    }

    #[test]
    fn a_child_among_adults_moves_the_scale_little() {
        let adults = crowd(4, 1.0, 3).measured;
        let alone = scale_from_people(&default_body(), &adults, None).unwrap();
        let mut with_child = adults.clone();
        with_child.push(adults[0].iter().map(|b| MeasuredSegment { length: 0.6 * b.length, ..*b }).collect());
        let both = scale_from_people(&default_body(), &with_child, None).unwrap();
        assert!((both.scale / alone.scale).ln().abs() < 0.05, "{} and {}", alone.scale, both.scale);
    }

    #[test]
    fn the_tallest_of_unlike_people_is_found() {
        let found = |seed: u64| {
            let crowd = crowd(3, 0.7, seed);
            let truth = (0..3).max_by(|&a, &b| crowd.statures[a].total_cmp(&crowd.statures[b])).unwrap();
            let second = (0..3).filter(|&p| p != truth).map(|p| crowd.statures[p]).fold(0.0, f64::max);
            let is_clear = crowd.statures[truth] > 1.05 * second;
            (!is_clear).then_some(true).or(Some(tallest(&default_body(), &crowd.measured) == Some(truth)))
        };
        assert!((0..100).filter_map(found).all(|right| right));
    }

    /// 5 to 6 % is the coefficient of variation of adults' stature, sexes pooled (ANSUR II).
    #[test]
    fn the_scale_of_nobody_is_as_uncertain_as_an_adults_stature() {
        let estimate = scale_of_nobody(&default_body());
        let sigma = estimate.interval95[1].ln() / INTERVAL_95;
        assert!(estimate.scale == 1.0 && (0.045..0.07).contains(&sigma), "{sigma}");
        assert!((estimate.interval95[0] * estimate.interval95[1] - 1.0).abs() < 1e-12);
    }

    #[test]
    fn nobody_measured_is_no_scale() {
        let body = default_body();
        assert!(scale_from_people(&body, &[Vec::new()], None).is_none());
        let known = KnownStature { person: 0, metres: 1.8, sigma_log: 0.01 };
        assert!(scale_from_people(&body, &[Vec::new()], Some(known)).is_none());
        assert_eq!(tallest(&body, &[Vec::new(), Vec::new()]), None);
    }
}
