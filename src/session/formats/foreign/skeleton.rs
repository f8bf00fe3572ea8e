//! Conversion of each source's order of points to one convention for the session, by joint names.

use super::header::Header;
use super::order_evidence::{Evidence, best_order};
use super::sources::Source;
use crate::body::skeleton::KeypointConvention;
use crate::session::formats::joints::{JointOrder, N_HANDS_POINTS, mapped};
use crate::session::formats::poses::PoseDialect;
use crate::session::upload::error::{Fault, UploadError, shown};
use crate::session::upload::warnings::Warnings;
use std::collections::BTreeMap;

/// Largest confidence of AlphaPose's COCO models.
const ALPHAPOSE_SCALE: f64 = 6.0;
/// Confidences up to this value are rounding errors of 1 and not another scale.
const ROUNDING: f64 = 1.05;
/// If all points lie within this distance of the origin, px, they are normalised coordinates.
const NORMALISED: f64 = 2.0;

/// Converts all sources to one convention and reports the mapping.
///
/// # Errors
/// Points of an unknown skeleton, or normalised coordinates.
pub(super) fn unify(
    sources: &mut [Source],
    header: &Header,
    warnings: &mut Warnings,
) -> Result<KeypointConvention, UploadError> {
    assign_identities(sources);
    normalise_confidences(sources, warnings);
    let mut orders = Vec::with_capacity(sources.len());
    for source in sources.iter() {
        let in_source = |e| UploadError { file: Some(source.poses.file.clone()), ..e };
        check_pixels(source).map_err(in_source)?;
        orders.push(order_of(source, header, warnings).map_err(in_source)?);
    }
    let convention = match &header.keypoint_convention {
        Some(name) => KeypointConvention::parse(name).ok_or_else(|| {
            Fault::ConventionUnknown
                .with(format!("keypoint_convention is {}, which is not a known convention", shown(name)))
        })?,
        None => widest_convention(&orders),
    };
    report(sources, &orders, convention, warnings);
    for (source, order) in sources.iter_mut().zip(&orders) {
        let map = order.map_to(convention);
        let is_identity = map.len() == order.joints.len() && map.iter().enumerate().all(|(i, m)| *m == Some(i));
        if !is_identity {
            let people = source.poses.detections.values_mut().flatten();
            people.for_each(|person| person.keypoints = mapped(&person.keypoints, &map));
        }
    }
    Ok(convention)
}

/// Where any file has placeholders, indices are identities in all files; then people without points are removed.
fn assign_identities(sources: &mut [Source]) {
    let is_by_position = sources.iter().any(|source| source.has_placeholders);
    for source in sources {
        for people in source.poses.detections.values_mut() {
            if is_by_position && source.dialect == PoseDialect::OpenPose {
                people.iter_mut().enumerate().for_each(|(i, person)| person.track_id = Some(i as i64));
            }
            people.retain(|person| !person.keypoints.is_empty());
        }
    }
}

/// Scales confidences to 0 to 1: AlphaPose's are divided where they exceed 1, all others are clipped.
fn normalise_confidences(sources: &mut [Source], warnings: &mut Warnings) {
    let largest = |source: &Source| {
        let people = source.poses.detections.values().flatten();
        people.flat_map(|person| &person.keypoints).map(|keypoint| keypoint.confidence).fold(0.0, f64::max)
    };
    let of_alphapose = sources.iter().filter(|source| source.is_alphapose).map(largest).fold(0.0, f64::max);
    let is_scaled = of_alphapose > ROUNDING;
    if is_scaled {
        warnings.add(format!("AlphaPose's confidences reach {of_alphapose:.2}: they are divided by {ALPHAPOSE_SCALE}"));
    }
    for source in sources {
        let scale = if is_scaled && source.is_alphapose { 1.0 / ALPHAPOSE_SCALE } else { 1.0 };
        let people = source.poses.detections.values_mut().flatten();
        for keypoint in people.flat_map(|person| &mut person.keypoints) {
            keypoint.confidence *= scale;
            if keypoint.confidence > 1.0 {
                warnings.clamped_confidence(keypoint.confidence);
                keypoint.confidence = 1.0;
            }
        }
    }
}

fn check_pixels(source: &Source) -> Result<(), UploadError> {
    let people = || source.poses.detections.values().flatten();
    let seen = || people().flat_map(|person| &person.keypoints).filter(|keypoint| keypoint.is_present());
    let n_seen = seen().take(50).count();
    Fault::KeypointInvalid.when(
        n_seen == 50 && seen().all(|keypoint| keypoint.pixel.amax() <= NORMALISED),
        || "all keypoints lie within 2 px of the origin: they are normalised coordinates, expected pixels",
    )?;
    Ok(())
}

/// The order of a source's points: as declared, as the file names them, or as selected by bone lengths.
fn order_of(source: &Source, header: &Header, warnings: &mut Warnings) -> Result<JointOrder, UploadError> {
    let people = || source.poses.detections.values().flatten();
    let Some(n_points) = people().map(|person| person.keypoints.len()).max() else {
        return Ok(JointOrder { name: "none".to_owned(), joints: Vec::new() });
    };
    for (frame, people) in &source.poses.detections {
        if let Some(person) = people.iter().position(|person| person.keypoints.len() != n_points) {
            let found = people[person].keypoints.len();
            let error =
                Fault::KeypointCount.with(format!("the person has {found} keypoints, but {n_points} in other frames"));
            return Err(UploadError { frame: Some(*frame), person: Some(person), ..error });
        }
    }
    let own = match declared_order(source, header, n_points)? {
        None => source.order.clone().and_then(|order| whole(order, n_points)),
        declared => declared,
    };
    if let Some(order) = own {
        Fault::SkeletonUnknown.when(order.n_named() < 4, || "fewer than 4 of the joint names are known")?;
        let completed = best_order(order.completions(), people());
        return Ok(completed.map_or(order, |evidence| evidence.order));
    }
    match best_order(JointOrder::candidates(n_points), people()) {
        None => Err(Fault::SkeletonUnknown.with(format!("no known skeleton has {n_points} points"))),
        Some(Evidence { order, is_unambiguous }) => {
            if !is_unambiguous {
                let camera = shown(source.names.first().map_or("", String::as_str));
                warnings.add(format!("the {n_points} points of {camera} are assumed to be {}; name the joints in session.json if that is wrong", order.name));
            }
            Ok(order)
        }
    }
}

/// The order that the header declares, for a source with this number of points.
///
/// # Errors
/// [`Fault::KeypointCount`] where the source has another number of points: an order that does not fit is a mistake, not a hint.
fn declared_order(source: &Source, header: &Header, n_points: usize) -> Result<Option<JointOrder>, UploadError> {
    let mismatch = |declared: String| {
        let camera = shown(source.names.first().map_or("", String::as_str));
        Fault::KeypointCount.with(format!("session.json {declared}, {camera} has {n_points}"))
    };
    if let Some(names) = &header.keypoint_names {
        let order = JointOrder::of_names("named", names.iter().map(String::as_str));
        return whole(order, n_points).map(Some).ok_or_else(|| mismatch(format!("names {} keypoints", names.len())));
    }
    let Some(convention) = header.keypoint_convention.as_deref().and_then(KeypointConvention::parse) else {
        return Ok(None);
    };
    // A camera may show no hand; a file that names its joints is converted to the convention.
    let of_names = || source.order.clone().and_then(|order| whole(order, n_points));
    let fitting = whole(JointOrder::of_convention(convention), n_points)
        .or_else(|| whole(JointOrder::of_body_of(convention), n_points))
        .or_else(of_names);
    let declared = || format!("declares {} with {} keypoints", convention.name(), convention.n_keypoints());
    fitting.map(Some).ok_or_else(|| mismatch(declared()))
}

/// The order with as many points: names are those of the body, and detectors write hands after it.
fn whole(order: JointOrder, n_points: usize) -> Option<JointOrder> {
    match n_points.checked_sub(order.joints.len()) {
        Some(0) => Some(order),
        Some(N_HANDS_POINTS) => Some(order.with_hands()),
        _ => None,
    }
}

/// The convention that keeps most joints of all sources; among equals that of the sources, then the smallest one.
fn widest_convention(orders: &[JointOrder]) -> KeypointConvention {
    let score = |convention: &KeypointConvention| {
        let own = JointOrder::of_convention(*convention);
        let kept: usize = orders.iter().map(|order| order.map_to(*convention).iter().flatten().count()).sum();
        let is_own = orders.iter().filter(|order| **order == own).count();
        (kept, is_own, std::cmp::Reverse(convention.n_keypoints()))
    };
    let mut best = KeypointConvention::Coco17;
    for convention in KeypointConvention::ALL {
        if score(&convention) > score(&best) {
            best = convention;
        }
    }
    best
}

/// Reports dialect, order, cameras and number of kept joints, one line per dialect and order.
fn report(sources: &[Source], orders: &[JointOrder], convention: KeypointConvention, warnings: &mut Warnings) {
    let mut lines: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for (source, order) in sources.iter().zip(orders) {
        let kept = order.map_to(convention).iter().flatten().count();
        let finding = format!(
            "{} with {} points in the order of {}, {kept} joints kept as {}",
            source.dialect.name(),
            order.joints.len(),
            shown(&order.name),
            convention.name()
        );
        lines.entry(finding).or_default().push(shown(source.names.first().map_or("", String::as_str)));
    }
    for (finding, cameras) in lines {
        warnings.add(format!("poses of {}: {finding}", cameras.join(", ")));
    }
}
