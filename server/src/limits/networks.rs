//! The networks that a client belongs to: what limits apply to, as addresses cost nothing.

use std::net::IpAddr;

/// Lengths of the IPv6 prefixes that providers assign to one customer (RFC 6177), longest first.
const PREFIXES: [u8; 3] = [64, 56, 48];

/// A network by its first address and the length of its prefix.
pub type Network = (IpAddr, u8);

/// The least network of a client: one IPv4 address or one IPv6 /64. An IPv4-mapped IPv6 address
/// counts as IPv4.
#[must_use]
pub fn client_network(address: IpAddr) -> IpAddr {
    prefix(address, PREFIXES[0])
}

/// The largest network that one customer may have: one IPv4 address or one IPv6 /48.
#[must_use]
pub fn client_site(address: IpAddr) -> IpAddr {
    prefix(address, PREFIXES[PREFIXES.len() - 1])
}

/// All networks of a client that may be one customer's, the least first: the owner of a short
/// prefix has all addresses below it.
pub fn client_networks(address: IpAddr) -> impl Iterator<Item = Network> {
    let prefixes: &[u8] = if address.to_canonical().is_ipv4() { &[32] } else { &PREFIXES };
    prefixes.iter().map(move |length| (prefix(address, *length), *length))
}

fn prefix(address: IpAddr, length: u8) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(six) => {
            let rest = 128 - u32::from(length);
            IpAddr::V6((u128::from(six) >> rest << rest).into())
        }
        four => four,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_ipv6_64_network_counts_as_one_address() {
        let parse = |text: &str| client_network(text.parse().unwrap());
        assert_eq!(parse("2001:db8:1:2::1"), parse("2001:db8:1:2:ffff::9"));
        assert_ne!(parse("2001:db8:1:2::1"), parse("2001:db8:1:3::1"));
        assert_eq!(parse("::ffff:10.0.0.1"), parse("10.0.0.1"));
        assert_ne!(parse("10.0.0.1"), parse("10.0.0.2"));
    }

    #[test]
    fn networks_of_an_address_contain_each_other() {
        let networks = |text: &str| client_networks(text.parse().unwrap()).collect::<Vec<_>>();
        let expected = [("2001:db8:1:203::", 64), ("2001:db8:1:200::", 56), ("2001:db8:1::", 48)];
        let expected = expected.map(|(text, length)| (text.parse::<IpAddr>().unwrap(), length));
        assert_eq!(networks("2001:db8:1:203::9"), expected);
        assert_eq!(client_site("2001:db8:1:203::9".parse().unwrap()), expected[2].0);
        assert_eq!(networks("::ffff:10.0.0.1"), [("10.0.0.1".parse().unwrap(), 32)]);
    }
}
