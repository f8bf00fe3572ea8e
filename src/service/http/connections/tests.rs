//! Which connections are closed, and when.

use super::*;

fn connections(max: usize, per_address: usize) -> Arc<Connections> {
    let limits = RequestLimits { max_connections_per_address: per_address, ..RequestLimits::default() };
    Connections::new(limits, max)
}

async fn entered(all: &Arc<Connections>, id: u64) -> Connection {
    all.enter(id, IpAddr::from([127, 0, 0, 1]), false).await
}

fn in_seconds(seconds: u64) -> Instant {
    Instant::now() + Duration::from_secs(seconds)
}

fn are_closed<const N: usize>(connections: [&Connection; N]) -> [bool; N] {
    connections.map(|connection| connection.close.is_cancelled())
}

#[tokio::test]
async fn full_service_closes_the_longest_idle_without_access() {
    let all = connections(3, 100);
    let [keyed, first, second] = [entered(&all, 0).await, entered(&all, 1).await, entered(&all, 2).await];
    drop(keyed.begin_request());
    keyed.note_access(true);
    assert!(!all.makes_room(Instant::now()), "a request may be on the way");
    assert!(all.makes_room(in_seconds(2)));
    assert_eq!(are_closed([&keyed, &first, &second]), [false, true, false]);
    let third = entered(&all, 3).await;
    let pending = keyed.begin_request();
    assert!(all.makes_room(in_seconds(2)));
    let fourth = entered(&all, 4).await;
    assert!(all.makes_room(in_seconds(2)));
    assert_eq!(are_closed([&keyed, &second, &third, &fourth]), [false, true, true, false]);
    drop(pending);
}

#[tokio::test]
async fn busy_connections_with_access_are_never_closed() {
    let all = connections(1, 100);
    let keyed = entered(&all, 0).await;
    keyed.note_access(true);
    let pending = keyed.begin_request();
    assert!(!all.makes_room(in_seconds(1000)));
    all.close_superfluous(in_seconds(1000));
    assert_eq!(are_closed([&keyed]), [false]);
    drop(pending);
    assert!(all.makes_room(in_seconds(2)));
    assert_eq!(are_closed([&keyed]), [true]);
}

#[tokio::test]
async fn idle_time_without_access_is_short() {
    let all = connections(10, 100);
    let [silent, open, keyed] = [entered(&all, 0).await, entered(&all, 1).await, entered(&all, 2).await];
    drop(open.begin_request());
    drop(keyed.begin_request());
    keyed.note_access(true);
    all.close_superfluous(in_seconds(4));
    assert_eq!(are_closed([&silent, &open, &keyed]), [false, false, false]);
    all.close_superfluous(in_seconds(6));
    assert_eq!(are_closed([&silent, &open, &keyed]), [true, true, false]);
    all.close_superfluous(in_seconds(76));
    assert_eq!(are_closed([&keyed]), [true]);
}

#[tokio::test]
async fn one_address_has_a_limited_number_without_access() {
    let all = connections(10, 2);
    let [first, second, third] = [entered(&all, 0).await, entered(&all, 1).await, entered(&all, 2).await];
    let elsewhere = all.enter(3, IpAddr::from([127, 0, 0, 2]), false).await;
    all.close_superfluous(in_seconds(2));
    assert_eq!(are_closed([&first, &second, &third, &elsewhere]), [true, false, false, false]);
    let [fourth, fifth] = [entered(&all, 4).await, entered(&all, 5).await];
    fourth.note_access(true);
    fifth.note_access(true);
    all.close_superfluous(in_seconds(2));
    assert_eq!(are_closed([&second, &third, &fourth, &fifth]), [false; 4]);
}

#[test]
fn addresses_of_one_ipv6_network_are_one_client() {
    let of = |text: &str| network(text.parse().unwrap());
    assert_eq!(of("2001:db8::1"), of("2001:db8::2:3"));
    assert_ne!(of("2001:db8::1"), of("2001:db8:0:1::1"));
    assert_eq!(of("::ffff:10.0.0.1"), of("10.0.0.1"));
    assert_ne!(of("10.0.0.1"), of("10.0.0.2"));
}
