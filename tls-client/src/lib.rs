//! Connections of clients to a server: TCP, or TLS over TCP by rustls.
//!
//! A server is trusted if its certificate is signed by an authority of the system, or by one of a
//! file that the user names.

#![forbid(unsafe_code)]

use rustls::crypto::ring;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, ServerName};
use rustls::{CertificateError, ClientConfig, RootCertStore};
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::client::TlsStream;
use tokio_util::either::Either;

/// An open connection.
pub type Transport = Either<TcpStream, Box<TlsStream<TcpStream>>>;

/// Why no TLS client can be made.
#[derive(Debug, thiserror::Error)]
pub enum TlsError {
    /// The file of authorities.
    #[error("cannot read certificates from {}: {cause}; give a file in PEM", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The cause.
        cause: String,
    },
    /// A file for an address without TLS.
    #[error("a ws:// address has no TLS, so no certificate; give a wss:// address or leave the file out")]
    Unused,
    /// The system has no authorities.
    #[error(
        "this system has no certificate authorities; install the package ca-certificates, or name a file"
    )]
    NoAuthorities,
}

/// Host and port to connect to, from those of a `ws` or `wss` address: IPv6 addresses have brackets
/// in URLs, but not in lookups; the default ports are 80 and 443 (RFC 6455, section 3).
#[must_use]
pub fn endpoint(host: Option<&str>, port: Option<u16>, has_tls: bool) -> (&str, u16) {
    let default = if has_tls { 443 } else { 80 };
    (host.unwrap_or_default().trim_matches(['[', ']']), port.unwrap_or(default))
}

/// Opens TLS connections over TCP.
#[derive(Clone)]
pub struct TlsClient {
    connector: TlsConnector,
}

impl std::fmt::Debug for TlsClient {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.debug_struct("TlsClient").finish_non_exhaustive()
    }
}

impl TlsClient {
    /// The client for addresses of a scheme; none unless it is `wss`.
    ///
    /// # Errors
    /// As [`TlsClient::new`], or a file where there is no TLS.
    pub fn of_scheme(scheme: Option<&str>, authorities: Option<&Path>) -> Result<Option<Self>, TlsError> {
        match (scheme, authorities) {
            (Some("wss"), authorities) => Self::new(authorities).map(Some),
            (_, Some(_)) => Err(TlsError::Unused),
            (_, None) => Ok(None),
        }
    }

    /// A client that trusts the authorities of the system, or only those of a file in PEM. A
    /// server's own certificate can stand there in place of its authority.
    ///
    /// # Errors
    /// The file has no certificate, or the system no authority.
    pub fn new(authorities: Option<&Path>) -> Result<Self, TlsError> {
        let roots = authorities.map_or_else(system_authorities, authorities_of)?;
        let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_safe_default_protocol_versions()
            .expect("the provider has the suites of TLS 1.2 and 1.3")
            .with_root_certificates(roots)
            .with_no_client_auth();
        Ok(Self { connector: TlsConnector::from(Arc::new(config)) })
    }

    /// Runs the TLS handshake. `host` is a name or an address, without brackets.
    ///
    /// # Errors
    /// The peer speaks no TLS, its certificate is not trusted, or the connection failed.
    pub async fn connect(&self, host: &str, stream: TcpStream) -> io::Result<Transport> {
        let name = ServerName::try_from(host.to_owned())
            .map_err(|_| io::Error::new(io::ErrorKind::InvalidInput, format!("`{host}` is no host name")))?;
        match self.connector.connect(name, stream).await {
            Ok(stream) => Ok(Either::Right(Box::new(stream))),
            Err(error) => Err(explained(&error)),
        }
    }
}

/// A failed handshake with what to do about it. Authorities are the remedy for an unknown one
/// alone.
fn explained(error: &io::Error) -> io::Error {
    let cause = error.get_ref().and_then(|cause| cause.downcast_ref::<rustls::Error>());
    let remedy = match cause {
        Some(rustls::Error::InvalidCertificate(why)) => match why {
            CertificateError::UnknownIssuer => "name its certificate authority with --ca-file",
            CertificateError::Expired | CertificateError::ExpiredContext { .. } => {
                "renew the server's certificate, or correct this machine's clock"
            }
            CertificateError::NotValidYet | CertificateError::NotValidYetContext { .. } => {
                "correct this machine's clock, or wait until the certificate is valid"
            }
            CertificateError::NotValidForName | CertificateError::NotValidForNameContext { .. } => {
                "connect to a name or an address that the certificate has"
            }
            CertificateError::BadSignature => {
                "name its authority with --ca-file; the trusted one of that name has another key"
            }
            _ => "the server needs another certificate",
        },
        Some(rustls::Error::InvalidMessage(_)) => "the server speaks no TLS, connect with ws://",
        _ => return io::Error::new(error.kind(), format!("TLS handshake: {error}")),
    };
    io::Error::new(error.kind(), format!("TLS handshake: {error}; {remedy}"))
}

fn system_authorities() -> Result<RootCertStore, TlsError> {
    let mut roots = RootCertStore::empty();
    // Certificates that this version cannot read are left out.
    roots.add_parsable_certificates(rustls_native_certs::load_native_certs().certs);
    if roots.is_empty() { Err(TlsError::NoAuthorities) } else { Ok(roots) }
}

/// The largest file of certificates, bytes: a hundred times what systems have.
const MAX_FILE: u64 = 32 << 20;

fn authorities_of(path: &Path) -> Result<RootCertStore, TlsError> {
    let failed = |cause: String| TlsError::File { path: path.into(), cause };
    // A device or a large file without lines has no end.
    let mut bytes = Vec::new();
    let file = File::open(path).and_then(|file| file.take(MAX_FILE + 1).read_to_end(&mut bytes));
    if file.map_err(|error| failed(error.to_string()))? as u64 > MAX_FILE {
        return Err(failed(format!("it has more than {} MiB", MAX_FILE >> 20)));
    }
    let mut roots = RootCertStore::empty();
    for certificate in CertificateDer::pem_slice_iter(&bytes) {
        let certificate = certificate.map_err(|error| failed(error.to_string()))?;
        roots.add(certificate).map_err(|error| failed(error.to_string()))?;
    }
    if roots.is_empty() { Err(failed("it has none".into())) } else { Ok(roots) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustls::pki_types::UnixTime;

    /// Linux has a device without an end.
    #[cfg(target_os = "linux")]
    #[test]
    fn a_file_without_end_is_no_file_of_certificates() {
        let error = authorities_of(Path::new("/dev/zero")).unwrap_err().to_string();
        assert!(error.contains("32 MiB"), "{error}");
    }

    #[test]
    fn host_and_port_are_those_of_the_address_or_of_its_scheme() {
        assert_eq!(endpoint(Some("[::1]"), Some(7), false), ("::1", 7));
        assert_eq!(endpoint(Some("example.org"), None, false), ("example.org", 80));
        assert_eq!(endpoint(Some("example.org"), None, true), ("example.org", 443));
    }

    #[test]
    fn a_file_for_an_address_without_tls_is_an_error() {
        let file = Some(Path::new("authority.pem"));
        assert!(matches!(TlsClient::of_scheme(Some("ws"), file), Err(TlsError::Unused)));
        assert!(matches!(TlsClient::of_scheme(Some("ws"), None), Ok(None)));
        assert!(matches!(TlsClient::of_scheme(Some("wss"), file), Err(TlsError::File { .. })));
    }

    #[test]
    fn only_an_unknown_authority_is_remedied_by_a_file_of_authorities() {
        let now = UnixTime::since_unix_epoch(std::time::Duration::from_secs(1));
        let name = ServerName::try_from("terrain.example").unwrap();
        for (why, remedy) in [
            (CertificateError::UnknownIssuer, "--ca-file"),
            (CertificateError::Expired, "renew"),
            (CertificateError::ExpiredContext { time: now, not_after: now }, "renew"),
            (CertificateError::NotValidYet, "clock"),
            (CertificateError::NotValidYetContext { time: now, not_before: now }, "clock"),
            (CertificateError::NotValidForName, "name or an address"),
            (
                CertificateError::NotValidForNameContext { expected: name, presented: vec!["other".into()] },
                "name or an address",
            ),
            (CertificateError::BadSignature, "another key"),
            (CertificateError::Revoked, "another certificate"),
        ] {
            let is_unknown = matches!(why, CertificateError::UnknownIssuer | CertificateError::BadSignature);
            let failed = io::Error::new(io::ErrorKind::InvalidData, rustls::Error::from(why));
            let text = explained(&failed).to_string();
            assert!(text.contains(remedy) && text.contains(&failed.to_string()), "{text}");
            assert_eq!(text.contains("--ca-file"), is_unknown, "{text}");
        }
    }

    #[test]
    fn a_file_without_certificates_is_an_error_with_its_name() {
        let path = std::env::temp_dir().join(format!("tombolo-authorities-{}", std::process::id()));
        for content in [None, Some(""), Some("no certificate"), Some("-----BEGIN CERTIFICATE-----\nx\n")] {
            let _ = std::fs::remove_file(&path);
            content.map_or(Ok(()), |content| std::fs::write(&path, content)).unwrap();
            let error = TlsClient::new(Some(&path)).unwrap_err().to_string();
            assert!(error.contains(&path.display().to_string()) && error.contains("PEM"), "{error}");
        }
        let _ = std::fs::remove_file(&path);
    }
}
