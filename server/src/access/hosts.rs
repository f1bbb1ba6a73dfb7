//! Which host names requests may be sent to, and which pages may open sessions.
//!
//! A page of another site reaches a server in two ways. It can give its own host name the server's
//! address (DNS rebinding): the browser then takes both for one origin, but sends that name in
//! `Host`. And it can open a WebSocket, which browsers do not restrict to one origin: they send
//! `Origin` and leave the decision to the server (RFC 6455, section 10.2).
//!
//! An IP address in `Host` is always allowed, since rebinding needs a name. A request without
//! `Host` (HTTP/1.0) or without `Origin` does not come from a page.

use axum::http::header::{HOST, ORIGIN};
use axum::http::uri::Authority;
use axum::http::{HeaderMap, Uri, Version};
use cli::UsageError;
use std::net::IpAddr;
use url::{Origin, Url};

/// Host names that requests may be sent to, in addition to IP addresses and names of the loopback.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AllowedHosts {
    /// In lower case.
    names: Vec<String>,
    any: bool,
}

/// Origins of pages that may open sessions, in addition to the server's own.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AllowedOrigins {
    /// As browsers write them: scheme, host, and the port unless it is the scheme's default.
    origins: Vec<String>,
    any: bool,
}

/// Host and port that a request was sent to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Target {
    /// In lower case, without brackets and final dot.
    host: String,
    port: Option<u16>,
}

impl AllowedHosts {
    /// Names without port; `*` allows any.
    ///
    /// # Errors
    /// A value is no host name.
    pub fn parse(values: &[String]) -> Result<Self, UsageError> {
        let mut hosts = Self::default();
        for value in values {
            if value == "*" {
                hosts.any = true;
                continue;
            }
            let authority = value.parse::<Authority>().ok();
            let authority = authority.filter(|authority| authority.host() == value && !value.contains('*'));
            let Some(authority) = authority else {
                return Err(UsageError::new(format!(
                    "allowed-host: `{value}` is no host name; give a whole name without port such as \
                     map.example, or * alone for any"
                )));
            };
            hosts.names.push(normal(authority.host()));
        }
        Ok(hosts)
    }

    /// Whether a request to this host is answered.
    #[must_use]
    pub fn allows(&self, target: &Target) -> bool {
        let host = target.host.as_str();
        self.any
            || host.parse::<IpAddr>().is_ok()
            || is_loopback_name(host)
            || self.names.iter().any(|name| name == host)
    }
}

impl AllowedOrigins {
    /// Origins such as `https://map.example:8443`; `*` allows any.
    ///
    /// # Errors
    /// A value is no origin.
    pub fn parse(values: &[String]) -> Result<Self, UsageError> {
        let mut allowed = Self::default();
        for value in values {
            if value == "*" {
                allowed.any = true;
                continue;
            }
            let url = Url::parse(value).ok().filter(|url| matches!(url.scheme(), "http" | "https"));
            let Some(url) = url.filter(|url| url.path() == "/" && url.query().is_none()) else {
                return Err(UsageError::new(format!(
                    "allowed-origin: `{value}` is no origin; give a scheme and host such as \
                     https://map.example, or *"
                )));
            };
            allowed.origins.push(url.origin().ascii_serialization());
        }
        Ok(allowed)
    }

    /// Whether a page may open a session: the server's own pages, and those of the list. A request
    /// without `Origin` does not come from a page.
    #[must_use]
    pub fn allows(&self, headers: &HeaderMap, target: Option<&Target>) -> bool {
        self.any
            || headers.get_all(ORIGIN).iter().all(|origin| {
                let origin = origin.to_str().ok().and_then(|origin| Url::parse(origin).ok());
                // `null`, of pages without an origin, is no URL.
                origin.is_some_and(|url| self.allows_origin(&url.origin(), target))
            })
    }

    fn allows_origin(&self, origin: &Origin, target: Option<&Target>) -> bool {
        let Origin::Tuple(scheme, host, port) = origin else { return false };
        if self.origins.contains(&origin.ascii_serialization()) {
            return true;
        }
        let (Some(target), Some(default)) = (target, default_port(scheme)) else { return false };
        let host = normal(&host.to_string());
        // One server has several loopback names.
        let is_same_host = host == target.host || (is_loopback(&host) && is_loopback(&target.host));
        is_same_host && *port == target.port.unwrap_or(default)
    }
}

impl Target {
    /// Where a request was sent: the authority of its URI, which counts first (RFC 9112, section
    /// 3.2.2), or `Host`. None without both, which only HTTP/1.0 may do.
    ///
    /// # Errors
    /// A host is malformed, or there are several `Host`, or none in HTTP/1.1, whatever the URI (RFC
    /// 9112, section 3.2).
    pub fn of(uri: &Uri, headers: &HeaderMap, version: Version) -> Result<Option<Self>, MalformedHost> {
        let mut values = headers.get_all(HOST).iter();
        let host = match (values.next(), values.next()) {
            (None, _) if version < Version::HTTP_11 => None,
            (Some(value), None) => {
                let authority: Authority = value.as_bytes().try_into().map_err(|_| MalformedHost)?;
                Some(Self::parse(&authority)?)
            }
            _ => return Err(MalformedHost),
        };
        uri.authority().map_or(Ok(host), |authority| Self::parse(authority).map(Some))
    }

    fn parse(authority: &Authority) -> Result<Self, MalformedHost> {
        let port = authority.as_str().strip_prefix(authority.host());
        let is_port =
            |port: &str| port.parse::<u16>().is_ok() && port.bytes().all(|byte| byte.is_ascii_digit());
        // The port may be empty (RFC 3986, section 3.2.3).
        let is_valid = port.is_some_and(|port| match port.strip_prefix(':') {
            Some(port) => port.is_empty() || is_port(port),
            None => port.is_empty(),
        });
        if !is_valid || authority.host().is_empty() {
            return Err(MalformedHost);
        }
        Ok(Self { host: normal(authority.host()), port: authority.port_u16() })
    }

    /// The host, for messages: at most 100 characters.
    #[must_use]
    pub fn shown(&self) -> String {
        self.host.chars().take(100).collect()
    }
}

/// A `Host` that names no host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MalformedHost;

/// A host in lower case, without the brackets of IPv6 addresses and the final dot of a full name.
fn normal(host: &str) -> String {
    let host = host.strip_prefix('[').and_then(|host| host.strip_suffix(']')).unwrap_or(host);
    host.strip_suffix('.').unwrap_or(host).to_ascii_lowercase()
}

/// `localhost` and names under it, which resolvers of browsers never ask a name server for (RFC
/// 6761, section 6.3).
fn is_loopback_name(host: &str) -> bool {
    host == "localhost" || host.ends_with(".localhost")
}

fn is_loopback(host: &str) -> bool {
    is_loopback_name(host) || host.parse::<IpAddr>().is_ok_and(|address| address.to_canonical().is_loopback())
}

fn default_port(scheme: &str) -> Option<u16> {
    match scheme {
        "http" => Some(80),
        "https" => Some(443),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn target(host: &str) -> Target {
        let mut headers = HeaderMap::new();
        headers.insert(HOST, host.parse().unwrap());
        Target::of(&Uri::from_static("/v1/live"), &headers, Version::HTTP_11).unwrap().unwrap()
    }

    fn hosts(values: &[&str]) -> Result<AllowedHosts, UsageError> {
        AllowedHosts::parse(&values.iter().map(ToString::to_string).collect::<Vec<_>>())
    }

    fn origins(values: &[&str]) -> Result<AllowedOrigins, UsageError> {
        AllowedOrigins::parse(&values.iter().map(ToString::to_string).collect::<Vec<_>>())
    }

    #[test]
    fn addresses_and_loopback_names_are_allowed_and_other_names_by_the_option_alone() {
        let (usual, named) = (hosts(&[]).unwrap(), hosts(&["Map.example", "replica-1"]).unwrap());
        for host in
            ["127.0.0.1:7580", "[::1]:7580", "192.168.1.5", "LOCALHOST:1", "a.localhost.", "[fe80::1]"]
        {
            assert!(usual.allows(&target(host)), "{host}");
        }
        for host in ["map.example", "MAP.EXAMPLE.:443", "replica-1:7580"] {
            assert!(!usual.allows(&target(host)) && named.allows(&target(host)), "{host}");
        }
        for host in [
            "evil.example",
            "localhost.evil.example",
            "127.0.0.1.evil.example",
            "notlocalhost",
            "a.map.example",
        ] {
            assert!(!named.allows(&target(host)), "{host}");
            assert!(hosts(&["*"]).unwrap().allows(&target(host)));
        }
    }

    #[test]
    fn a_pattern_is_no_host_name() {
        for pattern in ["*.map.example", "map.*", "a:1", "a/b"] {
            assert!(hosts(&[pattern]).unwrap_err().to_string().contains("allowed-host"), "{pattern}");
        }
    }

    #[test]
    fn the_target_is_the_uri_before_the_host_and_never_has_user_information() {
        let mut headers = HeaderMap::new();
        let uri: Uri = "http://evil.example/v1/live".parse().unwrap();
        let of = |uri: &Uri, headers: &HeaderMap| Target::of(uri, headers, Version::HTTP_11);
        let root = Uri::from_static("/");
        // RFC 9112, section 3.2.
        assert_eq!(of(&root, &headers), Err(MalformedHost));
        assert_eq!(Target::of(&root, &headers, Version::HTTP_10), Ok(None));
        assert_eq!(of(&uri, &headers), Err(MalformedHost));
        let old = Target::of(&uri, &headers, Version::HTTP_10).unwrap().unwrap();
        assert_eq!(old.host, "evil.example");
        headers.insert(HOST, "localhost".parse().unwrap());
        assert_eq!(of(&uri, &headers).unwrap().unwrap().host, "evil.example");
        headers.append(HOST, "evil.example".parse().unwrap());
        for uri in [&root, &uri] {
            assert_eq!(of(uri, &headers), Err(MalformedHost));
            assert_eq!(Target::of(uri, &headers, Version::HTTP_10), Err(MalformedHost));
        }
        for host in ["localhost:", "localhost:65535", "[::1]:0"] {
            headers.insert(HOST, host.parse().unwrap());
            assert!(of(&root, &headers).is_ok(), "{host}");
        }
        for host in [
            "evil.example@localhost",
            "a b",
            "",
            "localhost:a",
            "localhost:-1",
            "localhost:65536",
            "[::1]:+1",
        ] {
            headers.insert(HOST, host.parse().unwrap());
            assert_eq!(of(&root, &headers), Err(MalformedHost), "{host}");
            assert_eq!(of(&uri, &headers), Err(MalformedHost), "{host}");
        }
    }

    #[test]
    fn pages_of_the_server_itself_may_open_sessions_and_others_by_the_option_alone() {
        let may = |allowed: &AllowedOrigins, origin: &str, host: &str| {
            let mut headers = HeaderMap::new();
            headers.insert(ORIGIN, origin.parse().unwrap());
            allowed.allows(&headers, Some(&target(host)))
        };
        let usual = origins(&[]).unwrap();
        for (origin, host) in [
            ("http://127.0.0.1:7580", "127.0.0.1:7580"),
            ("http://localhost:7580", "127.0.0.1:7580"),
            ("http://[::1]:7580", "localhost:7580"),
            ("http://map.example", "map.example"),
            // Behind a proxy with TLS.
            ("https://map.example", "map.example"),
            ("https://map.example:8443", "map.example:8443"),
        ] {
            assert!(may(&usual, origin, host), "{origin} at {host}");
        }
        for (origin, host) in [
            ("http://evil.example", "127.0.0.1:7580"),
            ("http://evil.example:7580", "127.0.0.1:7580"),
            ("http://localhost:8080", "127.0.0.1:7580"),
            ("http://map.example:8080", "map.example"),
            ("https://localhost.evil.example", "localhost"),
            ("null", "127.0.0.1:7580"),
            ("file://", "127.0.0.1:7580"),
            ("", "127.0.0.1:7580"),
        ] {
            assert!(!may(&usual, origin, host), "{origin} at {host}");
            assert!(may(&origins(&["*"]).unwrap(), origin, host));
        }
        let named = origins(&["https://MAP.example:443"]).unwrap();
        assert!(may(&named, "https://map.example", "127.0.0.1:7580"));
        assert!(!may(&named, "http://map.example", "127.0.0.1:7580"));
        // Programs send none.
        assert!(usual.allows(&HeaderMap::new(), None));
        let mut two = HeaderMap::new();
        two.append(ORIGIN, "http://localhost".parse().unwrap());
        two.append(ORIGIN, "http://evil.example".parse().unwrap());
        assert!(!usual.allows(&two, Some(&target("localhost"))));
    }

    #[test]
    fn malformed_options_are_named() {
        for value in ["a:80", "http://a", "a/b", ""] {
            let message = hosts(&[value]).unwrap_err().to_string();
            assert!(message.starts_with("allowed-host: `") && message.contains(value), "{message}");
        }
        for value in ["map.example", "https://map.example/a", "ftp://a", ""] {
            let message = origins(&[value]).unwrap_err().to_string();
            assert!(message.starts_with("allowed-origin: `") && message.contains(value), "{message}");
        }
    }
}
