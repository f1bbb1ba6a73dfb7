//! TLS of connections, by rustls.

use crate::access::gate::Reloaded;
use cli::UsageError;
use rustls::ServerConfig;
use rustls::crypto::ring;
use rustls::pki_types::pem::PemObject;
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};
use tokio::net::TcpStream;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::server::TlsStream;
use tokio_util::either::Either;

/// A connection: plain, or by TLS. Boxed, since its state is some KiB.
pub type PeerStream = Either<TcpStream, Box<TlsStream<TcpStream>>>;

/// Certificate and key of new connections, with the files that they are read from again.
pub struct Tls {
    files: Files,
    current: RwLock<Current>,
}

/// Certificate chain and key, in PEM.
#[derive(Debug)]
struct Files {
    certificates: PathBuf,
    key: PathBuf,
}

struct Current {
    /// Of the content of both files.
    digest: blake3::Hash,
    config: Arc<ServerConfig>,
}

impl Files {
    fn read(&self) -> Result<Current, UsageError> {
        let read = |option, path: &Path| {
            std::fs::read(path).map_err(|error| failed(option, path, "cannot read", &error))
        };
        let (certificates, key) = (read("tls-cert", &self.certificates)?, read("tls-key", &self.key)?);
        let chain: Vec<_> = CertificateDer::pem_slice_iter(&certificates)
            .collect::<Result<_, _>>()
            .map_err(|error| failed("tls-cert", &self.certificates, "no certificates in PEM in", &error))?;
        if chain.is_empty() {
            return Err(failed("tls-cert", &self.certificates, "no certificates in PEM in", &"none found"));
        }
        let private = PrivateKeyDer::from_pem_slice(&key)
            .map_err(|error| failed("tls-key", &self.key, "no private key in PEM in", &error))?;
        let unusable =
            |error: rustls::Error| failed("tls-key", &self.key, "cannot use the certificate with", &error);
        let config = ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_safe_default_protocol_versions()
            .map_err(unusable)?
            .with_no_client_auth()
            .with_single_cert(chain, private)
            .map_err(unusable)?;
        let digest = blake3::Hasher::new().update(&certificates).update(b"\0").update(&key).finalize();
        Ok(Current { digest, config: Arc::new(with_protocols(config)) })
    }
}

/// HTTP/1.1 only, so that no client negotiates HTTP/2.
fn with_protocols(mut config: ServerConfig) -> ServerConfig {
    config.alpn_protocols = vec![b"http/1.1".to_vec()];
    config
}

fn failed(option: &str, path: &Path, what: &str, why: &dyn fmt::Display) -> UsageError {
    UsageError::new(format!("{option}: {what} `{}`: {why}", path.display()))
}

impl Tls {
    /// TLS with the files of both options; none without options.
    ///
    /// # Errors
    /// One without the other, or files without a usable certificate and its key.
    pub fn of_options(
        certificates: Option<PathBuf>,
        key: Option<PathBuf>,
    ) -> Result<Option<Arc<Self>>, UsageError> {
        let files = match (certificates, key) {
            (None, None) => return Ok(None),
            (Some(certificates), Some(key)) => Files { certificates, key },
            (Some(_), None) => {
                return Err(UsageError::new("tls-cert: there is no key; give tls-key FILE too"));
            }
            (None, Some(_)) => {
                return Err(UsageError::new("tls-key: there is no certificate; give tls-cert FILE too"));
            }
        };
        Ok(Some(Arc::new(Self { current: RwLock::new(files.read()?), files })))
    }

    /// Accepts connections with the current certificate.
    #[must_use]
    pub fn acceptor(&self) -> TlsAcceptor {
        Arc::clone(&self.current.read().unwrap_or_else(PoisonError::into_inner).config).into()
    }

    /// Reads the files again. Connections that are open go on.
    ///
    /// # Errors
    /// They have no usable certificate and key; the earlier ones stay.
    pub fn reload(&self) -> Result<Reloaded, UsageError> {
        let read = self.files.read()?;
        let mut current = self.current.write().unwrap_or_else(PoisonError::into_inner);
        if current.digest == read.digest {
            return Ok(Reloaded::Unchanged);
        }
        *current = read;
        Ok(Reloaded::Changed)
    }
}

impl fmt::Debug for Tls {
    /// Without the key.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Tls").field("files", &self.files).finish_non_exhaustive()
    }
}
