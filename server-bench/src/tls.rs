//! Cached chunks pushed over TLS and over plain TCP, in turn: processor time of the server for each
//! GB.

use crate::Plan;
use crate::cached::{CONNECTIONS, PUSH_WINDOW, Rate, measure};
use crate::clients::{Window, closed_loop};
use crate::connection::{Connection, open};
use crate::keys::{WORLD_SEED, land_keys};
use crate::rounds::Rounds;
use crate::server_process::ServerProcess;
use anyhow::{Context, Result};
use bars::Bar;
use bars::figures::{at, fill};
use serde_json::{Value, json};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use terrain::{ChunkKey, Land};
use tls_client::TlsClient;

/// Different chunks, as in `cached`.
const CHUNKS: usize = 256;

/// A certificate of this run, by openssl; removed when dropped.
struct Certificate(PathBuf);

impl Certificate {
    fn new() -> Result<Self> {
        let folder = std::env::temp_dir().join(format!("tombolo-certificate-{}", std::process::id()));
        std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
        let certificate = Self(folder);
        let mut openssl = Command::new("openssl");
        openssl
            .args(["req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes"])
            .args(["-days", "2", "-subj", "/CN=localhost", "-addext", "subjectAltName=DNS:localhost"])
            .args(["-addext", "basicConstraints=critical,CA:FALSE"])
            .arg("-keyout")
            .arg(certificate.path("key"))
            .arg("-out")
            .arg(certificate.path("crt"))
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        let made = openssl.status().context("cannot run openssl; install it")?;
        anyhow::ensure!(made.success(), "openssl made no certificate");
        Ok(certificate)
    }

    fn path(&self, extension: &str) -> PathBuf {
        self.0.join(format!("server.{extension}"))
    }
}

impl Drop for Certificate {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

/// A session over TLS.
async fn connect(tls: &TlsClient, address: SocketAddr) -> Result<Connection> {
    let transport = tls.connect("localhost", open(address).await?).await?;
    Connection::over(transport, address).await
}

async fn connect_all(tls: Option<&TlsClient>, server: &ServerProcess) -> Result<Vec<Connection>> {
    let Some(tls) = tls else { return server.connect(CONNECTIONS).await };
    let mut connections = Vec::with_capacity(CONNECTIONS);
    for _ in 0..CONNECTIONS {
        connections.push(connect(tls, server.address).await?);
    }
    Ok(connections)
}

/// Runs the benchmark: `plan.rounds` rounds of each, in turn.
pub async fn run(plan: &Plan) -> Result<Value> {
    let keys = land_keys(&Land::new(WORLD_SEED), 0, CHUNKS);
    let certificate = Certificate::new()?;
    let tls = TlsClient::new(Some(&certificate.path("crt")))?;
    let [cert, key] = ["crt", "key"].map(|extension| certificate.path(extension).display().to_string());
    let plain = ServerProcess::start(&plan.launch, &[])?;
    let secure = ServerProcess::start(&plan.launch, &["--tls-cert", &cert, "--tls-key", &key])?;
    for (server, tls) in [(&plain, None), (&secure, Some(&tls))] {
        let mut connections = connect_all(tls, server).await?;
        cache(&mut connections[0], &keys).await?;
    }
    let mut rounds = Rounds::default();
    let window = Window::Halves(PUSH_WINDOW);
    for _ in 0..plan.rounds {
        let without = measure(&plain, connect_all(None, &plain).await?, &keys, plan.seconds, window).await?;
        let connections = connect_all(Some(&tls), &secure).await?;
        let with = measure(&secure, connections, &keys, plan.seconds, window).await?;
        rounds.push("plain_cpu_s_per_gb", without.cpu_s_per_gb);
        rounds.push("tls_cpu_s_per_gb", with.cpu_s_per_gb);
        rounds.push("cpu_ratio", with.cpu_s_per_gb / without.cpu_s_per_gb);
        let rate = |of: Rate| of.chunks_per_s;
        rounds.push("chunks_ratio", rate(with) / rate(without));
    }
    Ok(rounds.add_to(json!({ "connections": CONNECTIONS, "rounds": plan.rounds })))
}

async fn cache(connection: &mut Connection, keys: &[ChunkKey]) -> Result<()> {
    let window = Window::OneByOne(keys.len());
    closed_loop(connection, keys.iter().copied(), window, None, |_| ()).await?.without_refusals().map(|_| ())
}

/// The bars of this benchmark.
pub fn bars(figures: &Value) -> Vec<Bar> {
    vec![
        Bar::at_most("TLS: server CPU per GB pushed, over plain", at(figures, "cpu_ratio"), "x", 2.0)
            .with_note("cached chunks, 64 clients; a certificate of ECDSA P-256; the median of the rounds"),
    ]
}

/// Further figures in sentences.
pub fn notes(figures: &Value) -> Vec<String> {
    let line = "TLS: {tls_cpu_s_per_gb:.2} CPU seconds a GB, plain {plain_cpu_s_per_gb:.2}; round by round \
                {cpu_ratio_rounds:.2}; {chunks_ratio:.2} of the chunks a second.";
    vec![fill(line, figures)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_bars::check;

    #[test]
    fn each_bar_can_be_missed() {
        check(bars, &json!({ "cpu_ratio": 1.8 }), &[("/cpu_ratio", json!(2.1))]);
    }
}
