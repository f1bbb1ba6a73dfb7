//! The data of a proxy about its client and about a trace: the PROXY header of a connection, and
//! headers of a request.

use axum::http::{HeaderMap, HeaderName, HeaderValue};
use server::proxy::{ProxyHeader, TrustedProxies, proxy_protocol};
use server::traces::Parent;
use std::net::{IpAddr, Ipv4Addr};
use std::pin::pin;
use std::sync::LazyLock;
use std::task::{Context, Poll, Waker};

/// Most bytes that a PROXY header takes.
const LONGEST: usize = 2048;

/// The proxy at the other end of the connection.
const PROXY: IpAddr = IpAddr::V4(Ipv4Addr::new(10, 0, 0, 1));

/// Headers that a first byte selects; others are a PROXY header.
static HEADERS: [(u8, HeaderName); 3] = [
    (b'x', HeaderName::from_static("x-forwarded-for")),
    (b'f', HeaderName::from_static("forwarded")),
    (b't', HeaderName::from_static("traceparent")),
];

/// Trusted proxies by either header.
static PROXIES: LazyLock<[TrustedProxies; 2]> = LazyLock::new(|| {
    [ProxyHeader::XForwardedFor, ProxyHeader::Forwarded]
        .map(|header| TrustedProxies::parse(&["10.0.0.0/8".to_owned()], Some(header)).expect("a network"))
});

/// Reads a header: the one that the first byte selects, or the PROXY header of a connection.
///
/// # Panics
/// More bytes are read than a PROXY header has, or the client depends on whether a proxy appended
/// to the list of another or wrote a line of its own.
#[must_use]
pub fn run(bytes: &[u8]) -> bool {
    let selected = bytes.split_first().and_then(|(first, value)| {
        HEADERS.iter().find(|(selector, _)| selector == first).map(|(_, name)| (name, value))
    });
    match selected {
        Some((name, value)) if name == "traceparent" => {
            one(name, value).is_some_and(|headers| Parent::of(&headers).is_some())
        }
        Some((name, value)) => one(name, value).is_some_and(|headers| forwarded(name, value, &headers)),
        None => proxy_header(bytes),
    }
}

fn one(name: &HeaderName, value: &[u8]) -> Option<HeaderMap> {
    let value = HeaderValue::from_bytes(value).ok()?;
    Some(HeaderMap::from_iter([(name.clone(), value)]))
}

fn forwarded(name: &HeaderName, value: &[u8], headers: &HeaderMap) -> bool {
    let proxies = &PROXIES[usize::from(name == "forwarded")];
    let client = proxies.client(PROXY, headers).0;
    if let Some(comma) = value.iter().rposition(|byte| *byte == b',') {
        let lines = [&value[..comma], &value[comma + 1..]].map(HeaderValue::from_bytes);
        if let [Ok(first), Ok(second)] = lines {
            let split = HeaderMap::from_iter([(name.clone(), first), (name.clone(), second)]);
            assert_eq!(proxies.client(PROXY, &split).0, client);
        }
    }
    client != PROXY
}

fn proxy_header(bytes: &[u8]) -> bool {
    let mut rest = bytes;
    // A slice is never pending.
    let Poll::Ready(read) =
        pin!(proxy_protocol::read(&mut rest)).poll(&mut Context::from_waker(Waker::noop()))
    else {
        panic!("the header waits for bytes that there are");
    };
    assert!(bytes.len() - rest.len() <= LONGEST);
    read.is_ok()
}

/// A header of each kind.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    let version_2 = |family: u8, addresses: &[u8]| {
        let length = (addresses.len() as u16).to_be_bytes();
        [&b"\r\n\r\n\0\r\nQUIT\n\x21"[..], &[family], &length, addresses].concat()
    };
    vec![
        b"PROXY TCP4 192.0.2.7 10.0.0.1 4711 80\r\n".into(),
        b"PROXY TCP6 2001:db8::7 ::1 4711 80\r\n".into(),
        b"PROXY UNKNOWN\r\n".into(),
        version_2(0x11, &[192, 0, 2, 7, 10, 0, 0, 1, 18, 103, 0, 80]),
        version_2(0x21, &[7; 36]),
        b"x192.0.2.7, 10.1.2.3".into(),
        b"x[2001:db8::7]:4711,10.1.2.3".into(),
        b"ffor=192.0.2.7;proto=https, for=\"[2001:db8::7]:4711\"".into(),
        b"ffor=_hidden, For=10.1.2.3".into(),
        b"x\xff, 192.0.2.7".into(),
        b"t00-4bf92f3577b34da6a3ce929d0e0e4736-00f067aa0ba902b7-01".into(),
    ]
}
