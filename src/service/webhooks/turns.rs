//! Which delivery is called next, so that receivers that do not answer delay nothing but the deliveries to them.
//!
//! The tenant with the fewest running calls is next, of several the one that was served the longest ago. Of its deliveries
//! first tries come before repetitions, then the order of creation counts. A tenant and a host have a maximal number of
//! running calls.

use super::delivery::Delivery;
use crate::service::failpoint::fault;
use std::collections::BTreeMap;
use ureq::http::Uri;

/// Maximal number of running calls; an unresponsive receiver occupies one of them for the timeout.
const MAX_CALLS: usize = 16;

/// Maximal number of running calls of one tenant: half of all, so that the calls of another tenant start immediately.
const MAX_OF_TENANT: usize = 8;

/// Maximal number of running calls to one host, so that many jobs that end together do not overrun their receiver.
const MAX_OF_HOST: usize = 4;

/// A delivery that waits for its turn.
#[derive(Debug)]
pub(super) struct Waiting {
    pub(super) delivery: Delivery,
    host: String,
}

impl Waiting {
    pub(super) fn new(delivery: Delivery) -> Self {
        let uri: Option<Uri> = delivery.url.parse().ok();
        let host = uri.as_ref().and_then(Uri::host).unwrap_or_default().to_ascii_lowercase();
        Self { delivery, host }
    }
}

/// Running calls, and the order in which tenants were served.
#[derive(Debug, Default)]
pub(super) struct Turns {
    running: Vec<Running>,
    /// Number of the last turn of each tenant.
    last: BTreeMap<String, u64>,
    turn: u64,
}

#[derive(Debug)]
struct Running {
    id: String,
    tenant: String,
    host: String,
}

impl Turns {
    /// Removes the delivery whose turn it is from `waiting`, which is in the order of one tenant's deliveries. `None` while
    /// no further call may run.
    pub(super) fn next(&mut self, waiting: &mut Vec<Waiting>) -> Option<Delivery> {
        if self.running.len() >= MAX_CALLS {
            return None;
        }
        let places = 0..waiting.len();
        let at = if fault("webhooks.unfair") {
            places.min_by_key(|at| &waiting[*at].delivery.created_at)?
        } else {
            places.filter(|at| self.may_run(&waiting[*at])).min_by_key(|at| self.rank(&waiting[*at]))?
        };
        let Waiting { delivery, host } = waiting.remove(at);
        let tenant = delivery.tenant.name().to_owned();
        self.turn += 1;
        self.last.insert(tenant.clone(), self.turn);
        self.running.push(Running { id: delivery.id.clone(), tenant, host });
        Some(delivery)
    }

    /// Notes the end of a call.
    pub(super) fn end(&mut self, id: &str) {
        self.running.retain(|call| call.id != id);
    }

    /// Whether a delivery is being called.
    pub(super) fn is_running(&self, id: &str) -> bool {
        self.running.iter().any(|call| call.id == id)
    }

    fn may_run(&self, waiting: &Waiting) -> bool {
        let of_host = self.running.iter().filter(|call| call.host == waiting.host).count();
        of_host < MAX_OF_HOST && self.n_running(waiting) < MAX_OF_TENANT
    }

    /// The lowest is next.
    fn rank(&self, waiting: &Waiting) -> (usize, u64) {
        let last = self.last.get(waiting.delivery.tenant.name()).copied();
        (self.n_running(waiting), last.unwrap_or(0))
    }

    fn n_running(&self, waiting: &Waiting) -> usize {
        self.running.iter().filter(|call| call.tenant == waiting.delivery.tenant.name()).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::store::Tenant;

    fn waiting(tenant: &str, host: &str, n: usize) -> Waiting {
        Waiting::new(Delivery {
            id: format!("{tenant}-{host}-{n}"),
            event: "job.succeeded".to_owned(),
            url: format!("http://{host}:9000/{n}"),
            state: "waiting".to_owned(),
            tries: 0,
            last_status: None,
            last_error: None,
            created_at: String::new(),
            updated_at: String::new(),
            job: String::new(),
            tenant: Tenant::parse(tenant).unwrap(),
        })
    }

    fn drain(turns: &mut Turns, waiting: &mut Vec<Waiting>) -> Vec<String> {
        std::iter::from_fn(|| turns.next(waiting)).map(|delivery| delivery.id).collect()
    }

    #[test]
    fn hanging_receivers_of_a_tenant_leave_calls_to_others() {
        let mut turns = Turns::default();
        let mut list: Vec<Waiting> = (0..200).map(|n| waiting("a", &format!("a{}.example", n % 50), n)).collect();
        assert_eq!(drain(&mut turns, &mut list).len(), MAX_OF_TENANT);
        list.push(waiting("b", "b.example", 0));
        assert_eq!(drain(&mut turns, &mut list), ["b-b.example-0"]);
        turns.end("b-b.example-0");
        assert!(drain(&mut turns, &mut list).is_empty());
    }

    #[test]
    fn a_host_gets_few_calls_at_the_same_time() {
        let mut turns = Turns::default();
        let mut list: Vec<Waiting> = (0..10).map(|n| waiting("a", "A.example", n)).collect();
        list.push(waiting("a", "other.example", 0));
        let first = drain(&mut turns, &mut list);
        assert_eq!(first.len(), MAX_OF_HOST + 1);
        assert!(turns.is_running(&first[0]));
        turns.end(&first[0]);
        assert_eq!(drain(&mut turns, &mut list), ["a-A.example-4"]);
    }

    #[test]
    fn tenants_take_turns() {
        let mut turns = Turns::default();
        let of = |tenant: &'static str| (0..4).map(move |n| waiting(tenant, &format!("{tenant}.example"), n));
        let mut list: Vec<Waiting> = of("a").chain(of("b")).chain(of("c")).collect();
        let order = drain(&mut turns, &mut list);
        let tenants: Vec<&str> = order.iter().map(|id| &id[..1]).collect();
        assert_eq!(tenants.concat(), "abcabcabcabc");
        for id in &order {
            turns.end(id);
        }
        list.extend(of("c").chain(of("a")).take(5));
        assert!(turns.next(&mut list).unwrap().id.starts_with('a'), "c was served later");
    }
}
