//! Which addresses a webhook may call: public ones, and private networks that the operator has listed.
//!
//! A URL is checked twice: its text when a job is submitted, and the resolved addresses at each call, which then connects
//! to exactly those addresses. A name that resolves differently later (DNS rebinding) therefore has no effect.

use crate::service::failpoint::fault;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use ureq::http::Uri;

/// List of networks.
#[derive(Debug, Default)]
pub struct Networks(Vec<Network>);

/// A network: its base address and the number of fixed leading bits.
#[derive(Debug)]
struct Network {
    base: u128,
    prefix: u32,
}

/// A text that is not a network.
#[derive(Debug, thiserror::Error)]
#[error("{setting}: {text:?} is neither an address nor a network such as 10.1.0.0/16")]
pub struct NetworkError {
    /// Name of the setting.
    pub setting: &'static str,
    /// The given text.
    pub text: String,
}

/// Why a URL is not allowed.
#[derive(Debug, thiserror::Error)]
pub enum TargetError {
    /// The URL is malformed.
    #[error("the URL is not allowed: {reason}")]
    Malformed {
        /// What is wrong.
        reason: &'static str,
    },
    /// The address is private.
    #[error("{host} is a private address")]
    Private {
        /// Host name or address.
        host: String,
    },
    /// The port is reserved for other services.
    #[error("port {port} is not allowed for webhooks")]
    Port {
        /// Port of the URL.
        port: u16,
    },
}

impl TargetError {
    /// How to fix the problem.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::Malformed { .. } => "use an http or https URL with a host and without user or password",
            Self::Private { .. } => {
                "use a public address, or ask the operator to list the network in webhooks.allowed_networks"
            }
            Self::Port { .. } => "use port 80, 443, or 1024 and above",
        }
    }
}

/// Maximal length of a URL, characters.
const MAX_URL: usize = 2000;

/// Checks the text of a URL.
///
/// # Errors
/// [`TargetError`].
pub fn check_url(url: &str, allowed: &Networks) -> Result<(), TargetError> {
    let malformed = |reason| TargetError::Malformed { reason };
    if url.len() > MAX_URL {
        return Err(malformed("it is too long"));
    }
    let uri: Uri = url.parse().map_err(|_| malformed("it cannot be parsed"))?;
    let default_port = match uri.scheme_str() {
        Some("http") => 80,
        Some("https") => 443,
        _ => return Err(malformed("its scheme is neither http nor https")),
    };
    let authority = uri.authority().ok_or_else(|| malformed("it has no host"))?;
    if authority.as_str().contains('@') {
        return Err(malformed("it contains a user or a password"));
    }
    let port = authority.port_u16().unwrap_or(default_port);
    if !(port == 80 || port == 443 || port >= 1024) {
        return Err(TargetError::Port { port });
    }
    check_host(authority.host(), allowed)
}

/// Checks a host; a name is checked again after it is resolved.
fn check_host(host: &str, allowed: &Networks) -> Result<(), TargetError> {
    let bare = host.trim_start_matches('[').trim_end_matches(']');
    if let Ok(address) = bare.parse::<IpAddr>() {
        return allowed.check(address);
    }
    let name = host.trim_end_matches('.').to_ascii_lowercase();
    if name == "localhost" || name.ends_with(".localhost") {
        return allowed.check(IpAddr::V4(Ipv4Addr::LOCALHOST));
    }
    // Some resolvers treat `2130706433`, `0x7f.1` and `0177.0.0.1` as addresses; none is a valid name.
    let last = name.rsplit('.').next().unwrap_or_default();
    if last.is_empty() || last.starts_with("0x") || last.chars().all(|c| c.is_ascii_digit()) {
        return Err(TargetError::Malformed { reason: "its host is neither a name nor a plain address" });
    }
    Ok(())
}

impl Networks {
    /// Parses the operator's list, the value of `setting`.
    ///
    /// # Errors
    /// [`NetworkError`] for the first invalid entry.
    pub fn parse(setting: &'static str, texts: &[String]) -> Result<Self, NetworkError> {
        let error = |text: &String| NetworkError { setting, text: text.clone() };
        texts.iter().map(|text| Network::parse(text).ok_or_else(|| error(text))).collect()
    }

    /// Checks whether an address may be called.
    ///
    /// # Errors
    /// [`TargetError::Private`].
    pub fn check(&self, address: IpAddr) -> Result<(), TargetError> {
        let is_listed = self.contain(address) || fault("webhooks.anywhere");
        if is_listed || is_public(address) { Ok(()) } else { Err(TargetError::Private { host: address.to_string() }) }
    }

    /// Whether an address is in one of the networks.
    pub fn contain(&self, address: IpAddr) -> bool {
        let bits = bits(address);
        self.0.iter().any(|network| network.contains(bits))
    }

    /// Checks all addresses of a name; one private address rejects the name.
    pub(super) fn check_all(&self, addresses: &[SocketAddr]) -> Result<(), TargetError> {
        addresses.iter().try_for_each(|address| self.check(address.ip()))
    }
}

impl FromIterator<Network> for Networks {
    fn from_iter<I: IntoIterator<Item = Network>>(networks: I) -> Self {
        Self(networks.into_iter().collect())
    }
}

impl Network {
    fn parse(text: &str) -> Option<Self> {
        let (address, prefix) = match text.split_once('/') {
            Some((address, prefix)) => (address, Some(prefix.parse::<u32>().ok()?)),
            None => (text, None),
        };
        let address: IpAddr = address.trim().parse().ok()?;
        let width = if address.is_ipv4() { 32 } else { 128 };
        let prefix = prefix.unwrap_or(width);
        (prefix <= width).then(|| Self { base: bits(address), prefix: prefix + 128 - width })
    }

    fn contains(&self, address: u128) -> bool {
        self.prefix == 0 || (self.base ^ address) >> (128 - self.prefix) == 0
    }
}

/// Bits of an address as IPv6; IPv4 addresses as `::ffff:a.b.c.d`.
fn bits(address: IpAddr) -> u128 {
    match address {
        IpAddr::V4(v4) => v4.to_ipv6_mapped().to_bits(),
        IpAddr::V6(v6) => v6.to_bits(),
    }
}

/// Whether an address is neither private nor special (IANA's special-purpose registries).
fn is_public(address: IpAddr) -> bool {
    match address {
        IpAddr::V4(v4) => is_public_v4(v4),
        IpAddr::V6(v6) => match embedded_v4(v6) {
            Some(v4) => is_public_v4(v4),
            // Global unicast is 2000::/3; without Teredo, benchmarking, ORCHID and documentation.
            None => {
                let [a, b, ..] = v6.segments();
                let is_special = (a == 0x2001 && (b < 0x200 || b == 0xdb8)) || a == 0x3fff;
                a & 0xe000 == 0x2000 && !is_special
            }
        },
    }
}

/// Returns the IPv4 address inside a mapped, translated (64:ff9b::/96) or 6to4 address.
fn embedded_v4(v6: Ipv6Addr) -> Option<Ipv4Addr> {
    let last = || Ipv4Addr::from_bits(v6.to_bits() as u32);
    match v6.segments() {
        [0, 0, 0, 0, 0, 0xffff, ..] | [0x64, 0xff9b, 0, 0, 0, 0, ..] => Some(last()),
        [0x2002, high, low, ..] => Some(Ipv4Addr::from_bits(u32::from(high) << 16 | u32::from(low))),
        _ => None,
    }
}

fn is_public_v4(v4: Ipv4Addr) -> bool {
    let [a, b, c, _] = v4.octets();
    let is_special = v4.is_private()
        || v4.is_loopback()
        || v4.is_link_local()
        || v4.is_multicast()
        || v4.is_documentation()
        || a == 0
        || a >= 240
        || (a == 100 && (64..128).contains(&b)) // carrier-grade NAT
        || (a == 192 && b == 0 && c == 0)
        || (a == 192 && b == 88 && c == 99)
        || (a == 198 && (b == 18 || b == 19));
    !is_special
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(url: &str, allowed: &[&str]) -> Result<(), TargetError> {
        let allowed: Vec<String> = allowed.iter().map(|text| (*text).to_owned()).collect();
        check_url(url, &Networks::parse("list", &allowed).unwrap())
    }

    #[test]
    fn rejects_private_and_malformed_targets() {
        for url in [
            "http://127.0.0.1/",
            "http://[::1]:8080/",
            "http://0.0.0.0/",
            "http://169.254.169.254/latest/meta-data",
            "http://10.0.0.1/",
            "http://172.16.9.9/",
            "http://192.168.1.1/",
            "http://100.64.0.1/",
            "http://[::ffff:127.0.0.1]/",
            "http://[::ffff:a00:1]/",
            "http://[64:ff9b::7f00:1]/",
            "http://[2002:7f00:1::]/",
            "http://[fe80::1]/",
            "http://[fd00::1]/",
            "http://localhost:9000/",
            "http://a.localhost./",
        ] {
            assert!(matches!(check(url, &[]), Err(TargetError::Private { .. })), "{url}");
        }
        for url in [
            "http://2130706433/",
            "http://0x7f.1/",
            "http://0177.0.0.1/",
            "http://127.1/",
            "file:///etc/passwd",
            "gopher://example.org/",
            "http://user:pass@example.org/",
            "http://user@example.org/",
            "/relative",
            "http://",
            "",
        ] {
            assert!(matches!(check(url, &[]), Err(TargetError::Malformed { .. })), "{url}");
        }
        assert!(matches!(check("http://example.org:22/", &[]), Err(TargetError::Port { port: 22 })));
        for url in ["https://example.org/hook?x=1", "http://93.184.216.34/", "http://[2606:2800:220:1::1]:8443/a"] {
            assert!(check(url, &[]).is_ok(), "{url}");
        }
    }

    #[test]
    fn accepts_networks_listed_by_the_operator() {
        let listed = ["127.0.0.0/8", "10.1.2.3", "fd00::/8"];
        for url in ["http://127.0.0.1:9000/", "http://localhost:9000/", "http://10.1.2.3/", "http://[fd00::7]/"] {
            assert!(check(url, &listed).is_ok(), "{url}");
        }
        for url in ["http://10.1.2.4/", "http://[fe80::1]/", "http://192.168.0.1/"] {
            assert!(check(url, &listed).is_err(), "{url}");
        }
        for text in ["10.0.0.0/33", "x", "10.0.0/8", "10.0.0.0/-1"] {
            let error = Networks::parse("limits.trusted_proxies", &[text.to_owned()]).unwrap_err().to_string();
            assert!(error.starts_with("limits.trusted_proxies: "), "another setting is named: {error}");
        }
    }

    #[test]
    fn rejects_names_with_any_private_address() {
        let addresses = ["93.184.216.34:80", "127.0.0.1:80"].map(|text| text.parse().unwrap());
        assert!(Networks::default().check_all(&addresses).is_err());
        assert!(Networks::default().check_all(&addresses[..1]).is_ok());
    }
}
