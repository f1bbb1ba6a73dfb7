//! The client of a request by `X-Forwarded-For` or `Forwarded` (RFC 7239).
//!
//! Each proxy appends the address that it was connected from. Read from the end, the first address
//! that is no trusted proxy's is the client's; what stands before it was written by the client.

use axum::http::header::FORWARDED;
use axum::http::{HeaderMap, HeaderName};
use std::net::{IpAddr, SocketAddr};

const X_FORWARDED_FOR: HeaderName = HeaderName::from_static("x-forwarded-for");

/// The client by `X-Forwarded-For`.
pub fn by_x_forwarded_for(
    connected: IpAddr,
    headers: &HeaderMap,
    is_trusted: impl Fn(IpAddr) -> bool,
) -> IpAddr {
    client(connected, headers, &X_FORWARDED_FOR, node, is_trusted)
}

/// The client by `Forwarded`.
pub fn by_forwarded(connected: IpAddr, headers: &HeaderMap, is_trusted: impl Fn(IpAddr) -> bool) -> IpAddr {
    client(connected, headers, &FORWARDED, for_parameter, is_trusted)
}

fn client(
    connected: IpAddr,
    headers: &HeaderMap,
    name: &HeaderName,
    address: impl Fn(&str) -> Option<IpAddr>,
    is_trusted: impl Fn(IpAddr) -> bool,
) -> IpAddr {
    let mut client = connected;
    let values: Vec<_> = headers.get_all(name).iter().collect();
    for value in values.into_iter().rev() {
        // Not the line as a whole: a proxy appends its element to bytes that are no text, too.
        for element in value.as_bytes().rsplit(|byte| *byte == b',') {
            let element = std::str::from_utf8(element).ok();
            // Hidden or malformed: the proxy that wrote it is the last one known.
            let Some(address) = element.and_then(|element| address(element.trim())) else { return client };
            client = address;
            if !is_trusted(address) {
                return client;
            }
        }
    }
    client
}

/// The address of the parameter `for` of an element.
fn for_parameter(element: &str) -> Option<IpAddr> {
    let node_of = |pair: &str| {
        let (name, value) = pair.split_once('=')?;
        name.trim().eq_ignore_ascii_case("for").then(|| value.trim().to_owned())
    };
    let value = element.split(';').find_map(node_of)?;
    node(value.strip_prefix('"').and_then(|value| value.strip_suffix('"')).unwrap_or(&value))
}

/// An address, with or without port; IPv6 with or without brackets.
fn node(text: &str) -> Option<IpAddr> {
    let in_brackets = || text.strip_prefix('[')?.strip_suffix(']')?.parse().ok();
    let address = text.parse().ok().or_else(|| text.parse().ok().map(|socket: SocketAddr| socket.ip()));
    address.or_else(in_brackets).map(|address: IpAddr| address.to_canonical())
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;

    type By = fn(IpAddr, &HeaderMap, fn(IpAddr) -> bool) -> IpAddr;

    /// Lines are Latin-1, so that `\u{ff}` is a byte that is no text.
    fn assert_clients(name: &'static str, by: By, cases: &[(&[&str], &str)]) {
        for (lines, expected) in cases {
            let mut headers = HeaderMap::new();
            for line in *lines {
                let bytes: Vec<u8> = line.chars().map(|letter| u8::try_from(letter).unwrap()).collect();
                headers.append(name, HeaderValue::from_bytes(&bytes).unwrap());
            }
            // Trusted are 10.0.0.0/8 and ::1.
            let is_trusted =
                |address: IpAddr| address.to_string().starts_with("10.") || address.is_loopback();
            let client = by("10.0.0.1".parse().unwrap(), &headers, is_trusted);
            assert_eq!(client, expected.parse::<IpAddr>().unwrap(), "{lines:?}");
        }
    }

    #[test]
    fn the_last_untrusted_address_of_x_forwarded_for_is_the_client() {
        assert_clients(
            "x-forwarded-for",
            by_x_forwarded_for,
            &[
                (&[], "10.0.0.1"),
                (&["192.0.2.7"], "192.0.2.7"),
                // The client claimed the first.
                (&["198.51.100.1, 192.0.2.7"], "192.0.2.7"),
                (&["198.51.100.1", "192.0.2.7"], "192.0.2.7"),
                (&["192.0.2.7, 10.0.0.2,10.0.0.3"], "192.0.2.7"),
                (&["192.0.2.7:4711"], "192.0.2.7"),
                (&["2001:db8::7"], "2001:db8::7"),
                (&["[2001:db8::7]:80"], "2001:db8::7"),
                (&["::ffff:192.0.2.7"], "192.0.2.7"),
                (&["192.0.2.7, nonsense"], "10.0.0.1"),
                (&["192.0.2.7, nonsense, 10.0.0.2"], "10.0.0.2"),
                (&["\u{ff}, 192.0.2.7"], "192.0.2.7"),
                (&["192.0.2.7, \u{ff}, 10.0.0.2"], "10.0.0.2"),
                (&["192.0.2.7", "\u{ff}"], "10.0.0.1"),
                (&["192.0.2.7,"], "10.0.0.1"),
                (&["10.0.0.9, ::1"], "10.0.0.9"),
            ],
        );
    }

    #[test]
    fn the_last_untrusted_address_of_forwarded_is_the_client() {
        assert_clients(
            "forwarded",
            by_forwarded,
            &[
                (&[], "10.0.0.1"),
                (&["for=192.0.2.7"], "192.0.2.7"),
                (&["For=\"[2001:db8:cafe::17]:4711\""], "2001:db8:cafe::17"),
                (&["for=198.51.100.1, proto=https; for=\"192.0.2.7:80\" ;by=10.0.0.1"], "192.0.2.7"),
                (&["for=\"x, for=198.51.100.1\"", "for=192.0.2.7, for=10.0.0.2"], "192.0.2.7"),
                (&["for=192.0.2.7, for=unknown"], "10.0.0.1"),
                (&["for=\u{ff}, for=192.0.2.7"], "192.0.2.7"),
                (&["for=192.0.2.7, for=_hidden, for=10.0.0.2"], "10.0.0.2"),
                (&["by=192.0.2.7"], "10.0.0.1"),
            ],
        );
    }
}
