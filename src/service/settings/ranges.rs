//! Ranges of the settings: a value that its type allows can still make no sense.

use super::{Role, Settings};

/// Checks that every value lies in its range.
///
/// # Errors
/// The first setting that does not, its value, and what to set.
pub(super) fn check(settings: &Settings) -> Result<(), String> {
    let Settings { store, blobs, role, worker, limits, tenants, jobs, webhooks, retention, .. } = settings;
    if store.url != "sqlite:" && blobs.url == "file:" {
        return Err("blobs.url is file:, the data folder of one process, but a PostgreSQL server is shared by several; set it to \
                    s3://bucket/prefix or file:///folder of all machines"
            .to_owned());
    }
    if store.url == "sqlite:" && *role != Role::All {
        return Err(format!(
            "role is {role:?}, but store.url is sqlite:, the database of one process; set store.url to a PostgreSQL server, or role to all"
        ));
    }
    if worker.beat.is_zero() || worker.lease < 3 * worker.beat {
        return Err(format!(
            "worker.lease_s is {}; set it to 3 times worker.beat_s or more, which is above 0",
            worker.lease.as_secs_f64()
        ));
    }
    if let Some(class) = worker.class.filter(|class| !(0..=3).contains(class)) {
        return Err(format!("worker.class is {class}; set it to 0, 1, 2 or 3, or leave it out"));
    }
    if jobs.max_losses == 0 {
        return Err("jobs.max_losses is 0, with which every lost worker ends its job; set it to 1 or more".to_owned());
    }
    if store.connections < 4 {
        return Err(format!("store.connections is {}; set it to 4 or more", store.connections));
    }
    for (name, count) in [
        ("jobs.concurrent", jobs.concurrent),
        ("limits.max_connections", limits.max_connections),
        ("limits.max_connections_per_address", limits.max_connections_per_address),
    ] {
        if count == 0 {
            return Err(format!("{name} is 0; set it to 1 or more"));
        }
    }
    for (name, count) in [
        ("limits.max_queued", limits.max_queued),
        ("tenants.max_bytes", tenants.max_bytes),
        ("tenants.max_queued", tenants.max_queued),
        ("tenants.max_running", tenants.max_running),
        ("webhooks.max_tries", webhooks.max_tries),
    ] {
        if count < 0 {
            return Err(format!("{name} is {count}; set it to 0 or more"));
        }
    }
    if limits.validation_timeout.is_zero() {
        return Err("limits.validation_timeout_s is 0, in which no upload can be read; set it to 1 or more".to_owned());
    }
    for (name, rate) in
        [("limits.bad_keys_per_s", limits.bad_keys_per_s), ("tenants.requests_per_s", tenants.requests_per_s)]
    {
        if !(rate.is_finite() && rate > 0.0) {
            return Err(format!("{name} is {rate}; set it to a number above 0"));
        }
    }
    for (name, days) in
        [("retention.jobs_days", retention.jobs_days), ("retention.sessions_days", retention.sessions_days)]
    {
        if let Some(days) = days.filter(|days| !(days.is_finite() && *days >= 0.0)) {
            return Err(format!("{name} is {days}; set it to 0 or more, or leave it out"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::layers::Layers;

    #[test]
    fn values_out_of_range_are_refused_by_name() {
        let checked = |key: &str, value: &str| Layers::default().word(key, value).unwrap().settings();
        for (key, value) in [
            ("jobs.concurrent", "0"),
            ("limits.max_connections", "0"),
            ("limits.max_connections_per_address", "0"),
            ("limits.max_queued", "-1"),
            ("tenants.max_bytes", "-1"),
            ("limits.validation_timeout_s", "0"),
            ("limits.bad_keys_per_s", "-1.0"),
            ("tenants.requests_per_s", "0.0"),
            ("tenants.requests_per_s", "nan"),
            ("tenants.requests_per_s", "inf"),
            ("retention.jobs_days", "-0.5"),
            ("store.connections", "3"),
            ("worker.lease_s", "10"),
            ("role", "worker"),
            ("worker.class", "4"),
            ("jobs.max_losses", "0"),
        ] {
            let error = checked(key, value).unwrap_err().to_string();
            assert!(error.starts_with(&format!("settings: {key} is ")), "{error}");
        }
        let postgres = Layers::default().word("store.url", "postgres://u:secret@h/d").unwrap();
        let error = postgres.settings().unwrap_err().to_string();
        assert!(error.starts_with("settings: blobs.url is file:") && !error.contains("secret"), "{error}");
        for (key, value) in [("tenants.requests_per_s", "0.01"), ("retention.jobs_days", "0.0")] {
            assert!(checked(key, value).is_ok(), "{key}={value}");
        }
    }
}
