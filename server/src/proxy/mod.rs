//! Proxies that name their clients: in a header of each request ([`forwarded`]) or once at the
//! start of a connection ([`proxy_protocol`]).
//!
//! Only proxies of a list are believed, and only in the one place that is configured: a proxy that
//! writes `X-Forwarded-For` may pass a client's own `Forwarded` on.

pub mod forwarded;
pub mod proxy_protocol;

use axum::http::HeaderMap;
use clap::ValueEnum;
use cli::UsageError;
use ipnet::IpNet;
use serde::Deserialize;
use std::net::IpAddr;

/// Where proxies name the client.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ProxyHeader {
    /// The header `X-Forwarded-For`
    #[default]
    XForwardedFor,
    /// The header `Forwarded` (RFC 7239)
    Forwarded,
    /// The PROXY protocol, version 1 or 2, before the first request of each connection
    ProxyProtocol,
}

/// The proxies that are believed.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TrustedProxies {
    networks: Vec<IpNet>,
    header: ProxyHeader,
}

/// Address of the client of a request: its peer's, or what a trusted proxy says. An extension of
/// requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClientAddress(pub IpAddr);

impl TrustedProxies {
    /// Addresses or networks in CIDR notation, and where they name the client. IPv4-mapped ones
    /// count as IPv4, as peers do.
    ///
    /// # Errors
    /// A value is neither, or a header is given without proxies.
    pub fn parse(values: &[String], header: Option<ProxyHeader>) -> Result<Self, UsageError> {
        if let (true, Some(header)) = (values.is_empty(), header) {
            let name =
                header.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned());
            return Err(UsageError::new(format!(
                "proxy-header: {name} without a proxy; give trusted-proxy CIDR too, or remove it"
            )));
        }
        let network = |value: &String| {
            let network = value.parse().or_else(|_| value.parse::<IpAddr>().map(IpNet::from));
            network.ok().and_then(unmapped).ok_or_else(|| {
                UsageError::new(format!(
                    "trusted-proxy: `{value}` is no address or network; give for example 10.0.0.0/8 or ::1"
                ))
            })
        };
        let networks = values.iter().map(network).collect::<Result<_, _>>()?;
        Ok(Self { networks, header: header.unwrap_or_default() })
    }

    /// Whether there are any.
    #[must_use]
    pub fn any(&self) -> bool {
        !self.networks.is_empty()
    }

    /// Whether this peer is one of them.
    #[must_use]
    pub fn contains(&self, peer: IpAddr) -> bool {
        let peer = peer.to_canonical();
        self.networks.iter().any(|network| network.contains(&peer))
    }

    /// Whether the connections of this peer begin with a PROXY header.
    #[must_use]
    pub fn sends_proxy_header(&self, peer: IpAddr) -> bool {
        self.header == ProxyHeader::ProxyProtocol && self.contains(peer)
    }

    /// The client of a request. `connected` is the address at the other end of its connection, or
    /// the one of its PROXY header.
    #[must_use]
    pub fn client(&self, connected: IpAddr, headers: &HeaderMap) -> ClientAddress {
        if !self.contains(connected) {
            return ClientAddress(connected);
        }
        let is_trusted = |address| self.contains(address);
        ClientAddress(match self.header {
            ProxyHeader::XForwardedFor => forwarded::by_x_forwarded_for(connected, headers, is_trusted),
            ProxyHeader::Forwarded => forwarded::by_forwarded(connected, headers, is_trusted),
            ProxyHeader::ProxyProtocol => connected,
        })
    }
}

/// An IPv4-mapped network as IPv4; none if a part of it is not.
fn unmapped(network: IpNet) -> Option<IpNet> {
    let IpNet::V6(six) = network else { return Some(network) };
    let Some(four) = six.addr().to_ipv4_mapped() else { return Some(network) };
    IpNet::new(four.into(), six.prefix_len().checked_sub(96)?).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn proxies(values: &[&str], header: Option<ProxyHeader>) -> Result<TrustedProxies, UsageError> {
        TrustedProxies::parse(&values.iter().map(ToString::to_string).collect::<Vec<_>>(), header)
    }

    fn address(text: &str) -> IpAddr {
        text.parse().unwrap()
    }

    #[test]
    fn only_a_named_proxy_is_believed_and_only_in_the_configured_header() {
        let mut headers = HeaderMap::new();
        headers.insert("x-forwarded-for", "192.0.2.1".parse().unwrap());
        headers.insert("forwarded", "for=192.0.2.2".parse().unwrap());
        for (header, client) in [
            (None, "192.0.2.1"),
            (Some(ProxyHeader::XForwardedFor), "192.0.2.1"),
            (Some(ProxyHeader::Forwarded), "192.0.2.2"),
            (Some(ProxyHeader::ProxyProtocol), "10.1.2.3"),
        ] {
            let proxies = proxies(&["10.0.0.0/8", "::1"], header).unwrap();
            assert_eq!(proxies.client(address("10.1.2.3"), &headers).0, address(client));
            let mapped = proxies.client(address("::ffff:10.1.2.3"), &headers).0;
            assert_eq!(mapped.to_canonical(), address(client));
            // A stranger's header is not.
            assert_eq!(proxies.client(address("11.1.2.3"), &headers).0, address("11.1.2.3"));
            assert_eq!(proxies.client(address("::2"), &headers).0, address("::2"));
        }
        let none = TrustedProxies::default();
        assert_eq!(none.client(address("127.0.0.1"), &headers).0, address("127.0.0.1"));
    }

    /// Before, no peer was of such a network: peers are never IPv4-mapped.
    #[test]
    fn ipv4_mapped_networks_are_those_of_ipv4() {
        for (mapped, inside, outside) in [
            ("::ffff:10.1.2.3", "10.1.2.3", "10.1.2.4"),
            ("::ffff:10.1.2.3/128", "10.1.2.3", "10.1.2.4"),
            ("::ffff:10.0.0.0/104", "10.255.0.1", "11.0.0.1"),
            ("::ffff:0.0.0.0/96", "192.0.2.1", "::1"),
        ] {
            let proxies = proxies(&[mapped], None).unwrap();
            assert!(proxies.contains(address(inside)), "{mapped}");
            assert!(proxies.contains(address(&format!("::ffff:{inside}"))), "{mapped}");
            assert!(!proxies.contains(address(outside)), "{mapped}");
        }
        let all = proxies(&["::/0"], None).unwrap();
        assert!(all.contains(address("2001:db8::1")) && !all.contains(address("10.1.2.3")));
    }

    #[test]
    fn malformed_options_are_named() {
        for (values, header, word) in [
            (&["10.0.0.0/33"][..], None, "10.0.0.0/33"),
            (&["proxy.example"][..], None, "proxy.example"),
            (&["::ffff:10.0.0.0/95"][..], None, "::ffff:10.0.0.0/95"),
            (&[][..], Some(ProxyHeader::Forwarded), "forwarded"),
        ] {
            let message = proxies(values, header).unwrap_err().to_string();
            assert!(message.contains(word) && !message.contains('\n'), "{message}");
        }
    }
}
