//! Metric scale from people: lengths of their body parts compared with those of adults.
//!
//! Shoulder and hip widths are left out: detectors place hips and shoulders by the skin.
//! The reference lengths are the default body's at beta 0 (ANSUR II and de Leva, see [`mod@super::default_body`]), men and
//! women half and half. The offset of a detector's joints from these is poorly known (knee and hip 30 to 50 mm,
//! ankle 1 to 15 mm, of varying direction: Needham et al. 2021, Sci. Rep. 11:20673): it is not corrected, the interval
//! includes it.

use super::kinematics::{Pose, joints_by_betas, landmark_by_betas, landmark_position, posed};
use super::model::{Betas, BodyModel};
use super::segments::{MeasuredSegment, Segment};
use crate::optim::determinant::half_log_det;
use crate::optim::robust::INTERVAL_95;
use nalgebra::{DMatrix, DVector, SMatrix, SVector};

/// Plausible heights of people, m.
pub const HEIGHT_RANGE: [f64; 2] = [0.5, 2.6];

/// Standard deviation of the detector's bias that all segments share, as a log ratio.
const COMMON_BIAS: f64 = 0.01;

/// Logarithm of a child's size against that of adults, mean and standard deviation: medians of 0.95 m at 3 years to 1.49 m at 12
/// (CDC growth charts, Kuczmarski et al. 2002, Vital Health Stat. 11(246)).
const CHILD_SIZE: [f64; 2] = [-0.33, 0.15];

/// Share of children among people who are recorded, before anything is measured. An assumption: of two people one counts as a child
/// from a difference of some 20 % on, which one pair of adults in a hundred has.
const CHILD_SHARE: f64 = 0.05;

/// Difference in size, log units, below which the smaller of two people is not asked whether they are a child.
const MIN_CHILD_DIFFERENCE: f64 = 0.1;

/// The factor from the cameras' unit to metres.
#[derive(Debug, Clone, PartialEq)]
pub struct ScaleEstimate {
    /// Metres per unit.
    pub scale: f64,
    /// 95 % confidence interval of the factor, for adults.
    pub interval95: [f64; 2],
    /// Measurements or assumptions that it is based on, one sentence.
    pub evidence: String,
}

/// Stature of a person's fitted body and the amount of data behind it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FittedStature {
    /// Stature of the fitted body, m.
    pub metres: f64,
    /// Number of keypoints used.
    pub n_keypoints: usize,
}

/// Estimates the metric scale from one or more people; `None` without any measured segment.
///
/// Generalised least squares over the logarithms of all people's segments, `log(reference / measured) = s + e`. The
/// covariance of `e` contains the differences between adults (from the model's betas, independent between people: stature
/// and proportions), the detector's bias (the same for all people), and the measurement noise. A person with accurate
/// measurements therefore counts more, and several people narrow the interval down to the detector's bias, not below it.
/// People who differ from the others (a duplicate) get Huber's weight at 2 standard deviations.
///
/// Beside adults the smallest people may be children (a size of 0.72 of adults, 16 % either way), so that the scale is the mean over
/// their number, by the probability of each: of two people, one a third smaller than the other, the larger one is the adult.
/// Known limit: children alone count as adults.
pub fn scale_from_people(model: &BodyModel, people: &[Vec<MeasuredSegment>]) -> Option<ScaleEstimate> {
    let (mean, n_children) = mean_over_children(&segment_rows(model, people))?;
    let half = INTERVAL_95 * mean.variance.sqrt();
    let n_samples: usize = people.iter().flatten().map(|segment| segment.n_samples).sum();
    let n_seen = people.iter().filter(|segments| !segments.is_empty()).count();
    let people_text = match (n_seen, n_children) {
        (1, _) => "1 person".to_owned(),
        (n, 0) => format!("{n} people"),
        (n, 1) => format!("{n} people, the smallest taken for a child,"),
        (n, children) => format!("{n} people, the {children} smallest taken for children,"),
    };
    Some(ScaleEstimate {
        scale: mean.value.exp(),
        interval95: [(mean.value - half).exp(), (mean.value + half).exp()],
        evidence: format!(
            "limbs, trunks and heads of {people_text} ({n_samples} lengths) against those of adults; differences between adults and \
             the detector's keypoint bias leave the scale uncertain to {:.1} %",
            100.0 * half
        ),
    })
}

/// The mean over the number of children, and the likeliest number. `rows`: by person.
fn mean_over_children(rows: &[Vec<Row>]) -> Option<(Mean, usize)> {
    let of_all = |kin: Kin| rows.iter().map(|rows| Sums::of(rows, kin)).collect::<Option<Vec<Sums>>>();
    let (as_adults, as_children) = (of_all(Kin::ADULT)?, of_all(Kin::CHILD)?);
    let mean_of = |(p, sums): (usize, &Sums)| Some((p, sums.mean()?.value));
    let mut by_size: Vec<(usize, f64)> = as_adults.iter().enumerate().filter_map(mean_of).collect();
    // Ratios to the reference: the smallest people first.
    by_size.sort_by(|a, b| b.1.total_cmp(&a.1));
    let largest = by_size.last()?.1;
    let n_smaller = by_size.iter().take_while(|(_, ratio)| ratio - largest > MIN_CHILD_DIFFERENCE).count();
    let taken_for = |n_children: usize| {
        let mut kin = vec![Kin::ADULT; rows.len()];
        by_size[..n_children].iter().for_each(|&(p, _)| kin[p] = Kin::CHILD);
        let sums = kin.iter().enumerate().map(|(p, kin)| if kin.is_child { &as_children[p] } else { &as_adults[p] });
        let sums: Vec<&Sums> = sums.collect();
        (kin, sums)
    };
    let posterior = |n_children: usize| {
        let prior = n_children as f64 * (CHILD_SHARE / (1.0 - CHILD_SHARE)).ln();
        Some((n_children, prior + mean_of_sums(taken_for(n_children).1)?.log_evidence))
    };
    let mut posteriors: Vec<(usize, f64)> = (0..=n_smaller).filter_map(posterior).collect();
    let highest = posteriors.iter().map(|(_, log)| *log).max_by(f64::total_cmp)?;
    posteriors.retain(|(_, log)| log - highest > -NEGLIGIBLE);
    let robust = |(n_children, log): (usize, f64)| {
        let (kin, sums) = taken_for(n_children);
        Some((n_children, log, robust_mean(rows, kin, &sums)?))
    };
    mixed(&posteriors.into_iter().filter_map(robust).collect::<Vec<_>>())
}

/// The mean over hypotheses, and the likeliest of them. Of each: the number of children, its log probability, its mean.
fn mixed(hypotheses: &[(usize, f64, Mean)]) -> Option<(Mean, usize)> {
    let likeliest = hypotheses.iter().max_by(|a, b| a.1.total_cmp(&b.1))?;
    let weights: Vec<f64> = hypotheses.iter().map(|(_, log, _)| (log - likeliest.1).exp()).collect();
    let total: f64 = weights.iter().sum();
    let weighted = || hypotheses.iter().map(|(_, _, mean)| mean).zip(weights.iter().map(|weight| weight / total));
    let value: f64 = weighted().map(|(mean, weight)| weight * mean.value).sum();
    let spread = |mean: &Mean| mean.variance + (mean.value - value).powi(2);
    let variance = weighted().map(|(mean, weight)| weight * spread(mean)).sum();
    Some((Mean { value, variance, log_evidence: likeliest.1 }, likeliest.0))
}

/// From the mean of all with Huber's weights of people who differ from the others. `own`: the sums of each person.
fn robust_mean(rows: &[Vec<Row>], mut kin: Vec<Kin>, own: &[&Sums]) -> Option<Mean> {
    let own_means: Vec<Option<Mean>> = own.iter().map(|sums| sums.mean()).collect();
    let mut mean = mean_of_sums(own.iter().copied())?;
    for _ in 0..ROBUST_ROUNDS {
        for (kin, own) in kin.iter_mut().zip(&own_means) {
            let Some(own) = own else { continue };
            let distance = (own.value - mean.value).abs() / own.variance.sqrt();
            kin.looseness = (distance / 2.0).max(1.0);
        }
        let sums = rows.iter().zip(&kin).map(|(rows, kin)| Sums::of(rows, *kin)).collect::<Option<Vec<Sums>>>()?;
        mean = mean_of_sums(&sums)?;
    }
    Some(mean)
}

/// The scale under the assumption that people are average adults, for a single view, in which a small near person looks
/// like a large far one. The interval is that of one adult's stature.
pub fn scale_of_average_adults(model: &BodyModel) -> ScaleEstimate {
    let half = INTERVAL_95 * stature_per_beta(model).norm();
    ScaleEstimate {
        scale: 1.0,
        interval95: [(-half).exp(), half.exp()],
        evidence: format!(
            "single view: people are assumed to be as large as an average adult, hence the size of each and the distance \
             from the camera are uncertain to {:.0} %",
            100.0 * half
        ),
    }
}

/// Nats below the likeliest number of children from which another one cannot change the mean.
const NEGLIGIBLE: f64 = 30.0;

/// Re-weightings of people; Huber's weights converge within a few.
const ROBUST_ROUNDS: usize = 5;

/// One measured segment as the log ratio of the average adult's length to this person's.
struct Row {
    /// `y`.
    ratio: f64,
    /// The body part, which determines the detector's bias.
    segment: Segment,
    /// Change of the length's logarithm per beta.
    log_per_beta: Betas,
    /// Standard deviation of the measurement.
    sigma: f64,
}

/// The rows of every person.
fn segment_rows(model: &BodyModel, people: &[Vec<MeasuredSegment>]) -> Vec<Vec<Row>> {
    let references = Segment::ALL.map(|segment| reference_segment(model, segment));
    let row = |measured: &MeasuredSegment| {
        let reference = references[measured.segment as usize].as_ref()?;
        Some(Row {
            ratio: (reference.length / measured.length).ln(),
            segment: measured.segment,
            log_per_beta: reference.log_per_beta,
            // 0.2 % keeps the matrix regular also for exact lengths.
            sigma: measured.sigma_log.hypot(0.002),
        })
    };
    people.iter().map(|segments| segments.iter().filter_map(row).collect()).collect()
}

/// Change of the stature's logarithm per beta, from the difference between +1 and -1: the stature is linear except where
/// the highest vertex changes.
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
    /// Length, m.
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

/// What a person is taken for.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Kin {
    is_child: bool,
    /// Factor of the variance between adults.
    looseness: f64,
}

impl Kin {
    const ADULT: Self = Self { is_child: false, looseness: 1.0 };
    const CHILD: Self = Self { is_child: true, looseness: 1.0 };

    /// Mean and standard deviation of the size against that of adults, log units.
    fn size(self) -> [f64; 2] {
        if self.is_child { CHILD_SIZE } else { [0.0, 0.0] }
    }
}

/// A mean and its variance.
struct Mean {
    value: f64,
    variance: f64,
    /// Logarithm of the probability of the ratios, whatever the mean; up to a constant of the rows.
    log_evidence: f64,
}

const N_SEGMENTS: usize = Segment::ALL.len();

/// Sums over people, from which their common mean follows: people are independent but for the detector's bias of each of the few
/// kinds of segments, so that the work grows with their number, not with its cube.
///
/// With the segments `G` of a person's rows (one column a kind) and the covariance `D` of the rows without that bias.
#[derive(Default)]
struct Sums {
    /// `G^T D^-1 G`.
    information: SMatrix<f64, N_SEGMENTS, N_SEGMENTS>,
    /// `G^T D^-1 y`.
    weighted: SVector<f64, N_SEGMENTS>,
    /// `y^T D^-1 y`.
    square: f64,
    /// `log |D| / 2`.
    half_log_det: f64,
}

impl Sums {
    /// Of one person, whose ratios as a child are those of its size.
    fn of(rows: &[Row], kin: Kin) -> Option<Self> {
        let [size, size_sigma] = kin.size();
        let covariance = DMatrix::from_fn(rows.len(), rows.len(), |i, j| {
            let (a, b) = (&rows[i], &rows[j]);
            let noise = if i == j { a.sigma * a.sigma } else { 0.0 };
            a.log_per_beta.dot(&b.log_per_beta) * kin.looseness + size_sigma * size_sigma + noise
        });
        let factor = covariance.cholesky()?;
        let segments =
            DMatrix::from_fn(rows.len(), N_SEGMENTS, |i, k| f64::from(u8::from(rows[i].segment as usize == k)));
        let ratios = DVector::from_iterator(rows.len(), rows.iter().map(|row| row.ratio + size));
        let (of_segments, of_ratios) = (factor.solve(&segments), factor.solve(&ratios));
        Some(Self {
            information: SMatrix::from_fn(|i, j| segments.column(i).dot(&of_segments.column(j))),
            weighted: SVector::from_fn(|k, _| segments.column(k).dot(&of_ratios)),
            square: ratios.dot(&of_ratios),
            half_log_det: half_log_det(&factor),
        })
    }

    fn add(&mut self, other: &Self) {
        self.information += other.information;
        self.weighted += other.weighted;
        self.square += other.square;
        self.half_log_det += other.half_log_det;
    }

    /// The mean under the covariance `C = D + G B G^T` of all rows, with the variances `B` of the biases:
    /// `s = 1^T C^-1 y / 1^T C^-1 1`, variance `1 / 1^T C^-1 1`; the evidence is
    /// `-(y - s 1)^T C^-1 (y - s 1) / 2 - log |C| / 2 - log (1^T C^-1 1) / 2`. The bias that all segments share shifts the mean
    /// itself: it adds to the variance and leaves value and evidence.
    ///
    /// `1^T C^-1 = (N^-1 B^-1 1)^T G^T D^-1` with `N = B^-1 + G^T D^-1 G`, and `log |C| = log |D| + log |B| + log |N|`.
    fn mean(&self) -> Option<Mean> {
        let inverse_biases = DVector::from_iterator(N_SEGMENTS, Segment::ALL.map(|s| s.detector_bias().powi(-2)));
        let information = DMatrix::from_column_slice(N_SEGMENTS, N_SEGMENTS, self.information.as_slice());
        let factor = (information + DMatrix::from_diagonal(&inverse_biases)).cholesky()?;
        let shares = factor.solve(&inverse_biases);
        let total = shares.dot(&self.information.column_sum());
        let value = shares.dot(&self.weighted) / total;
        let explained = self.weighted.dot(&factor.solve(&DVector::from_column_slice(self.weighted.as_slice())));
        let errors = self.square - explained - value * value * total;
        let half_log_det = self.half_log_det + half_log_det(&factor);
        let log_evidence = -(errors + total.ln()) / 2.0 - half_log_det;
        let variance = 1.0 / total + COMMON_BIAS * COMMON_BIAS;
        (value.is_finite() && total > 0.0).then_some(Mean { value, variance, log_evidence })
    }
}

/// The mean of some people, by the sums of each.
fn mean_of_sums<'a>(people: impl IntoIterator<Item = &'a Sums>) -> Option<Mean> {
    let mut sums = Sums::default();
    people.into_iter().for_each(|person| sums.add(person));
    sums.mean()
}

#[cfg(test)]
mod tests {
    use super::super::default_body::default_body;
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// People drawn from the population, seen by a detector of random biases, in units of 1 / `scale` m.
    fn crowd(n_people: usize, scale: f64, seed: u64) -> Vec<Vec<MeasuredSegment>> {
        let model = default_body();
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let common = COMMON_BIAS * normal();
        let biases = Segment::ALL.map(|segment| common + segment.detector_bias() * normal());
        let mut person = |_| {
            let betas = Betas::from_fn(|_, _| normal());
            let measured = |segment: Segment| {
                let reference = reference_segment(&model, segment).unwrap();
                let log = reference.log_per_beta.dot(&betas) + biases[segment as usize];
                let length = reference.length * log.exp() / scale;
                MeasuredSegment { segment, length, sigma_log: 0.003, n_samples: 500 }
            };
            Segment::ALL.map(measured).to_vec()
        };
        (0..n_people).map(&mut person).collect()
    }

    /// 95 % of 400 draws have a binomial standard deviation of 1.1 %.
    #[test]
    fn the_interval_covers_the_truth_in_95_percent() {
        for n_people in [1, 2, 4] {
            let (mut covered, mut squares) = (0, 0.0);
            for seed in 0..400 {
                let estimate = scale_from_people(&default_body(), &crowd(n_people, 2.5, seed)).unwrap();
                covered += usize::from(estimate.interval95[0] < 2.5 && 2.5 < estimate.interval95[1]);
                squares += (estimate.scale / 2.5).ln().powi(2);
            }
            let sd = (squares / 400.0_f64).sqrt();
            println!("{n_people} people: sd {:.2} %, covered {:.3}", sd * 100.0, covered as f64 / 400.0);
            assert!((0.91..=0.98).contains(&(covered as f64 / 400.0)));
            assert!((0.02..0.065).contains(&sd));
        }
    }

    #[test]
    fn a_child_among_adults_moves_the_scale_little() {
        let adults = crowd(4, 1.0, 3);
        let alone = scale_from_people(&default_body(), &adults).unwrap();
        let mut with_child = adults.clone();
        with_child.push(adults[0].iter().map(|b| MeasuredSegment { length: 0.6 * b.length, ..*b }).collect());
        let both = scale_from_people(&default_body(), &with_child).unwrap();
        assert!((both.scale / alone.scale).ln().abs() < 0.05, "{} and {}", alone.scale, both.scale);
    }

    /// One person as many times as large as measured.
    fn resized(person: &[MeasuredSegment], factor: f64) -> Vec<MeasuredSegment> {
        person.iter().map(|segment| MeasuredSegment { length: factor * segment.length, ..*segment }).collect()
    }

    /// The mean of an adult and a child had been taken for that of adults: lengths 11 to 19 % off, stated to 10.
    #[test]
    fn of_an_adult_and_a_child_the_adult_shows_the_scale() {
        let (mut covered, mut squares) = (0, 0.0);
        for seed in 0..100 {
            let people = crowd(2, 2.5, seed);
            let with_child = vec![resized(&people[0], 0.62 + 0.0013 * seed as f64), people[1].clone()];
            let estimate = scale_from_people(&default_body(), &with_child).unwrap();
            covered += usize::from(estimate.interval95[0] < 2.5 && 2.5 < estimate.interval95[1]);
            squares += (estimate.scale / 2.5).ln().powi(2);
        }
        let sd = (squares / 100.0_f64).sqrt();
        println!("sd {:.2} %, covered {covered}", sd * 100.0);
        // One adult alone: 6 %.
        assert!(covered >= 88 && sd < 0.075, "{covered}, {sd}");
    }

    #[test]
    fn children_are_named_in_the_evidence() {
        let people = crowd(3, 1.0, 5);
        let family = vec![people[0].clone(), resized(&people[1], 0.6), resized(&people[2], 0.65)];
        let evidence = scale_from_people(&default_body(), &family).unwrap().evidence;
        assert!(evidence.contains("3 people, the 2 smallest taken for children,"), "{evidence}");
        assert!(!scale_from_people(&default_body(), &people).unwrap().evidence.contains("child"));
    }

    /// 5 to 6 % is the coefficient of variation of adults' stature, sexes pooled (ANSUR II).
    #[test]
    fn the_assumed_scale_is_as_uncertain_as_stature() {
        let estimate = scale_of_average_adults(&default_body());
        let sigma = estimate.interval95[1].ln() / INTERVAL_95;
        assert!(estimate.scale == 1.0 && (0.045..0.07).contains(&sigma), "{sigma}");
        assert!((estimate.interval95[0] * estimate.interval95[1] - 1.0).abs() < 1e-12);
    }

    /// Value, variance and evidence of people's common mean, from the covariance of all rows at once.
    fn dense_mean(people: &[(&[Row], Kin)]) -> [f64; 3] {
        let rows: Vec<(usize, Kin, &Row)> =
            people.iter().enumerate().flat_map(|(p, (rows, kin))| rows.iter().map(move |row| (p, *kin, row))).collect();
        let covariance = DMatrix::from_fn(rows.len(), rows.len(), |i, j| {
            let ((p, kin, a), (q, _, b)) = (rows[i], rows[j]);
            let bias = if a.segment == b.segment { a.segment.detector_bias().powi(2) } else { 0.0 };
            let person = a.log_per_beta.dot(&b.log_per_beta) * kin.looseness + kin.size()[1].powi(2);
            let noise = if i == j { a.sigma.powi(2) } else { 0.0 };
            COMMON_BIAS.powi(2) + bias + noise + if p == q { person } else { 0.0 }
        });
        let ratios = DVector::from_iterator(rows.len(), rows.iter().map(|(_, kin, row)| row.ratio + kin.size()[0]));
        let factor = covariance.cholesky().unwrap();
        let weights = factor.solve(&DVector::repeat(rows.len(), 1.0));
        let value = weights.dot(&ratios) / weights.sum();
        let errors = ratios.add_scalar(-value);
        let evidence = -(errors.dot(&factor.solve(&errors)) + weights.sum().ln()) / 2.0 - half_log_det(&factor);
        [value, 1.0 / weights.sum(), evidence]
    }

    #[test]
    fn sums_over_people_give_the_mean_of_all_rows_at_once() {
        let mut people = crowd(4, 40.0, 11);
        people[1].truncate(2);
        people[3].clear();
        let rows = segment_rows(&default_body(), &people);
        let means = [[1.0; 4], [1.0, 2.5, 1.0, 1.0]].map(|looseness: [f64; 4]| {
            let kin = |p: usize| Kin { looseness: looseness[p], ..if p == 2 { Kin::CHILD } else { Kin::ADULT } };
            let sums: Vec<Sums> = (0..4).map(|p| Sums::of(&rows[p], kin(p)).unwrap()).collect();
            let dense = dense_mean(&(0..4).map(|p| (rows[p].as_slice(), kin(p))).collect::<Vec<_>>());
            (mean_of_sums(&sums).unwrap(), dense)
        });
        for (mean, [value, variance, _]) in &means {
            assert!((mean.value - value).abs() < 1e-11 && (mean.variance / variance - 1.0).abs() < 1e-10);
        }
        let [one, other] = means.map(|(mean, [_, _, evidence])| mean.log_evidence - evidence);
        assert!((one - other).abs() < 1e-8, "the same constant: {one} and {other}");
    }

    /// Each of 60 numbers of children took six factorisations of a matrix of 1,200 rows: minutes.
    #[test]
    fn of_a_crowd_of_200_all_were_solved_at_once() {
        let mut people = crowd(200, 2.5, 17);
        people.iter_mut().take(60).for_each(|person| *person = resized(person, 0.72));
        let estimate = scale_from_people(&default_body(), &people).unwrap();
        let [low, high] = estimate.interval95;
        assert!(low < 2.5 && 2.5 < high && high / low < 1.2, "{low} to {high}");
        assert!(estimate.evidence.contains("smallest taken for children"), "{}", estimate.evidence);
    }

    #[test]
    fn no_measurements_give_no_scale() {
        assert!(scale_from_people(&default_body(), &[Vec::new()]).is_none());
    }
}
