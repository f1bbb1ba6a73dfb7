//! Cached chunks over HTTP, like with like: the same bytes from our chunk route and from nginx as
//! static files, requested by the same client over keep-alive connections with one request in
//! flight on each.
//!
//! The two do not do the same work: ours looks up a key in the cache and the validator of its
//! content, which is kept once computed, nginx copies an open file.

use crate::Plan;
use crate::connection::get_bytes;
use crate::keys::{WORLD_SEED, land_keys};
use crate::nginx::{self, Nginx};
use crate::rounds::Rounds;
use crate::server_process::ServerProcess;
use crate::wrk::{Load, Wrk};
use anyhow::{Result, ensure};
use bars::Bar;
use bars::figures::{at, fill};
use protocol::chunk_codec;
use serde_json::{Value, json};
use std::net::SocketAddr;
use terrain::Land;

/// Different chunks, requested in turn, as in `cached`.
const CHUNKS: usize = 256;

/// Keep-alive connections.
const CONNECTIONS: usize = 64;

/// Runs the benchmark: in each round nginx, our server, and nginx again as its own control.
pub async fn run(plan: &Plan) -> Result<Value> {
    ensure!(
        ["nginx", "wrk"].iter().all(|program| nginx::is_installed(program)),
        "nginx or wrk is not installed; run: apt-get install --no-install-recommends nginx-light wrk"
    );
    let land = Land::new(WORLD_SEED);
    let keys = land_keys(&land, 0, CHUNKS);
    let frames: Vec<_> =
        keys.iter().map(|key| chunk_codec::encode(&land.chunk(*key), &land.digest())).collect();
    let our_path = |key: &terrain::ChunkKey| {
        format!("/v1/{}/chunk/{}/{}/{}", land.digest(), key.level(), key.x(), key.z())
    };
    let our_paths: Vec<_> = keys.iter().map(our_path).collect();
    let (server, nginx) = (ServerProcess::start(&plan.launch, &[])?, Nginx::start(&plan.launch, &frames)?);
    let their_paths = Nginx::paths(frames.len());
    // Afterwards all chunks are in the cache, and all files open.
    verify(server.address, &our_paths, &frames).await?;
    verify(nginx.address, &their_paths, &frames).await?;

    let (ours, theirs) = (Wrk::new("ours", &our_paths)?, Wrk::new("nginx", &their_paths)?);
    let load = Load { connections: CONNECTIONS, in_flight: 1, seconds: plan.seconds };
    let mut rounds = Rounds::default();
    for _ in 0..plan.rounds {
        let before = theirs.measure(nginx.address, &nginx.process, load)?;
        let our = ours.measure(server.address, &server.process, load)?;
        let after = theirs.measure(nginx.address, &nginx.process, load)?;
        let nginx_per_s = f64::midpoint(before.replies_per_s, after.replies_per_s);
        rounds.push("ratio_to_nginx", our.replies_per_s / nginx_per_s);
        let ratio = after.replies_per_s / before.replies_per_s;
        rounds.push("nginx_ratio_to_itself", ratio.max(1.0 / ratio));
        rounds.push("replies_per_s", our.replies_per_s);
        rounds.push("nginx_replies_per_s", nginx_per_s);
        rounds.push("server_cpu_us", 1e6 * our.busy / our.replies_per_s);
        rounds.push("nginx_cpu_us", 1e6 * after.busy / after.replies_per_s);
        rounds.push("server_busy", our.busy);
        rounds.push("nginx_busy", before.busy.min(after.busy));
        rounds.push("reply_bytes", our.reply_bytes);
        rounds.push("nginx_reply_bytes", after.reply_bytes);
    }
    let bytes: usize = frames.iter().map(bytes::Bytes::len).sum();
    Ok(rounds.add_to(json!({
        "connections": CONNECTIONS,
        "in_flight": load.in_flight,
        "frame_bytes": bytes / CHUNKS,
    })))
}

/// Requests every path once and compares the body byte for byte.
async fn verify(address: SocketAddr, paths: &[String], frames: &[bytes::Bytes]) -> Result<()> {
    for (path, frame) in paths.iter().zip(frames) {
        ensure!(get_bytes(address, path).await? == *frame, "{path} of {address} has other bytes");
    }
    Ok(())
}

/// The bars of this benchmark.
pub fn bars(figures: &Value) -> Vec<Bar> {
    let of = |path| at(figures, path);
    vec![
        Bar::reported("HTTP: chunks of our route over nginx's files", of("ratio_to_nginx"), "x").with_note(
            "the same bytes by the same client: wrk, a closed loop over 64 keep-alive connections with one \
             request in flight on each; median of interleaved rounds",
        ),
        Bar::at_least(
            "HTTP: share of the time in which our server was busy (control)",
            of("server_busy"),
            "",
            0.8,
        ),
        Bar::at_least("HTTP: the same of nginx (control)", of("nginx_busy"), "", 0.8),
        Bar::at_most(
            "HTTP: nginx over itself in a round, or the inverse (control)",
            of("nginx_ratio_to_itself"),
            "x",
            1.1,
        )
        .with_note("the median of the rounds, each the larger of both ratios: the noise of the machine"),
    ]
}

/// Further figures in sentences.
pub fn notes(figures: &Value) -> Vec<String> {
    let line = "HTTP, one request in flight on each of {connections:.0} connections: our route \
                {replies_per_s:.0} replies a second at {server_cpu_us:.1} us of CPU, {reply_bytes:.0} \
                bytes with headers; nginx {nginx_replies_per_s:.0} at {nginx_cpu_us:.1} us, \
                {nginx_reply_bytes:.0} bytes. Ours over nginx round by round: {ratio_to_nginx_rounds:.2}; \
                nginx over itself: {nginx_ratio_to_itself_rounds:.2}.";
    vec![fill(line, figures)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_bars::{check, check_absent};

    #[test]
    fn each_bar_can_be_missed() {
        let good = json!({
            "ratio_to_nginx": 0.5, "nginx_ratio_to_itself": 1.0, "server_busy": 0.99, "nginx_busy": 0.97,
        });
        // The client was the bottleneck, so the ratio would be one of the client with itself.
        let bad = [
            ("/server_busy", json!(0.5)),
            ("/nginx_busy", json!(0.79)),
            ("/nginx_ratio_to_itself", json!(1.2)),
            ("/nginx_ratio_to_itself", json!(1.11)),
        ];
        check(bars, &good, &bad);
        check_absent(bars, &good, &[("", "ratio_to_nginx", 1), ("", "nginx_ratio_to_itself", 1)]);
    }
}
