//! TLS of connections, by rustls.

use crate::access::gate::Reloaded;
use crate::limits::site_turns::SiteTurns;
use cli::UsageError;
use futures_util::poll;
use rustls::crypto::ring;
use rustls::pki_types::pem::{self, PemObject};
use rustls::pki_types::{CertificateDer, PrivateKeyDer};
use rustls::server::{Acceptor, ParsedCertificate};
use rustls::{Error, InconsistentKeys, ServerConfig};
use std::future::poll_fn;
use std::net::IpAddr;
use std::num::NonZero;
use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};
use std::task::Poll;
use std::{fmt, io};
use tokio::net::TcpStream;
use tokio_rustls::LazyConfigAcceptor;
use tokio_rustls::server::TlsStream;
use tokio_util::either::Either;

/// Keys that the cryptography of rustls (ring) signs with.
const KEY_KINDS: &str = "RSA of 2048 to 4096 bits, ECDSA on P-256 or P-384, Ed25519";

/// Marks of encrypted keys: of PKCS #8 (RFC 7468, section 11), and of OpenSSL's older formats (RFC
/// 1421, section 4.6.1.1).
const ENCRYPTED: [&str; 2] = ["-----BEGIN ENCRYPTED PRIVATE KEY-----", "Proc-Type: 4,ENCRYPTED"];

/// A connection: plain, or by TLS. Boxed, since its state is some KiB.
pub type PeerStream = Either<TcpStream, Box<TlsStream<TcpStream>>>;

/// The TCP stream of a connection.
#[must_use]
pub fn tcp_stream(stream: &PeerStream) -> &TcpStream {
    match stream {
        Either::Left(stream) => stream,
        Either::Right(stream) => stream.get_ref().0,
    }
}

/// Certificate and key of new connections, with the files that they are read from again.
pub struct Tls {
    files: Files,
    current: RwLock<Current>,
    /// At the expensive part of handshakes: half of the threads at most.
    turns: SiteTurns,
}

/// Certificate chain and key, in PEM.
#[derive(Debug)]
struct Files {
    certificates: PathBuf,
    key: PathBuf,
}

/// Certificate and key that were read.
pub struct Current {
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
        let chain: Vec<_> =
            CertificateDer::pem_slice_iter(&certificates).collect::<Result<_, _>>().map_err(|error| {
                failed("tls-cert", &self.certificates, "no certificates in PEM in", &pem_fault(&error))
            })?;
        let Some(own) = chain.first() else {
            return Err(failed("tls-cert", &self.certificates, "no certificates in PEM in", &"none found"));
        };
        if ParsedCertificate::try_from(own).is_err() {
            let why = "the first one is no valid X.509 certificate";
            return Err(failed("tls-cert", &self.certificates, "cannot use the certificates in", &why));
        }
        let private = PrivateKeyDer::from_pem_slice(&key).map_err(|error| match is_encrypted(&key) {
            true => {
                let why = "it is encrypted; decrypt it: openssl pkey -in ENCRYPTED -out FILE";
                failed("tls-key", &self.key, "cannot use the private key in", &why)
            }
            false => failed("tls-key", &self.key, "no private key in PEM in", &pem_fault(&error)),
        })?;
        if ring::sign::any_supported_type(&private).is_err() {
            let why = format!("it is damaged or of another kind than {KEY_KINDS}");
            return Err(failed("tls-key", &self.key, "cannot use the private key in", &why));
        }
        let unusable = |error: Error| {
            let why = match error {
                Error::InconsistentKeys(InconsistentKeys::KeyMismatch) => {
                    "it is the key of another certificate".into()
                }
                error => error.to_string(),
            };
            failed("tls-key", &self.key, "cannot use the certificate with", &why)
        };
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

/// The fault of a file in PEM. The library's text has bytes of the file as numbers, which may be
/// those of a key.
fn pem_fault(error: &pem::Error) -> &'static str {
    match error {
        pem::Error::NoItemsFound => "none found",
        pem::Error::MissingSectionEnd { .. } => "a section has no `-----END` line; the file may be cut off",
        pem::Error::IllegalSectionStart { .. } => "a `-----BEGIN` line is damaged",
        pem::Error::Base64Decode(_) => "a section is not in base64",
        _ => "a section is too large",
    }
}

fn is_encrypted(key: &[u8]) -> bool {
    let key = String::from_utf8_lossy(key);
    ENCRYPTED.iter().any(|mark| key.contains(mark))
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
        let threads = std::thread::available_parallelism().map_or(1, NonZero::get);
        let turns = SiteTurns::new(threads.div_ceil(2));
        Ok(Some(Arc::new(Self { current: RwLock::new(files.read()?), files, turns })))
    }

    /// The handshake of a connection, with the current certificate. Its key exchange and signature
    /// take up to some milliseconds of a thread, and their request costs a client nothing: sites
    /// take turns.
    ///
    /// # Errors
    /// The client ends the connection or sends no valid handshake.
    pub async fn accept(&self, stream: TcpStream, client: IpAddr) -> io::Result<TlsStream<TcpStream>> {
        let hello = LazyConfigAcceptor::new(Acceptor::default(), stream).await?;
        let turn = self.turns.acquire(Some(client)).await;
        let mut rest = Box::pin(hello.into_stream(self.config()));
        let mut first = poll!(&mut rest);
        drop(turn);
        // Any further bytes may cause the work: a client can ask for another key exchange.
        loop {
            match first {
                Poll::Ready(accepted) => return accepted,
                Poll::Pending => woken().await,
            }
            let turn = self.turns.acquire(Some(client)).await;
            first = poll!(&mut rest);
            drop(turn);
        }
    }

    /// Turns at handshakes.
    #[must_use]
    pub const fn turns(&self) -> &SiteTurns {
        &self.turns
    }

    fn config(&self) -> Arc<ServerConfig> {
        Arc::clone(&self.current.read().unwrap_or_else(PoisonError::into_inner).config)
    }

    /// Reads the files again, without using them.
    ///
    /// # Errors
    /// They have no usable certificate and key.
    pub fn read(&self) -> Result<Current, UsageError> {
        self.files.read()
    }

    /// Uses what [`Tls::read`] returned for new connections. Those that are open go on.
    pub fn replace(&self, read: Current) -> Reloaded {
        let mut current = self.current.write().unwrap_or_else(PoisonError::into_inner);
        if current.digest == read.digest {
            return Reloaded::Unchanged;
        }
        *current = read;
        Reloaded::Changed
    }
}

/// Waits until the task is woken once, by a future that was polled before or by any other one.
async fn woken() {
    let mut is_woken = false;
    poll_fn(|_| if std::mem::replace(&mut is_woken, true) { Poll::Ready(()) } else { Poll::Pending }).await;
}

impl fmt::Debug for Current {
    /// Without the key.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Current").field("digest", &self.digest).finish_non_exhaustive()
    }
}

impl fmt::Debug for Tls {
    /// Without the key.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Tls").field("files", &self.files).finish_non_exhaustive()
    }
}
