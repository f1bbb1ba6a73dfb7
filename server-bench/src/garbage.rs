//! A viewer whose server sends garbage: a proxy in front of a real server corrupts what passes.
//!
//! A viewer without a window asks for a view, gives up or draws it, and the next one begins. Beside
//! them one viewer lives as long as the run: its sessions are cut, which it does not give a server
//! up for, so that memory that sessions leave behind adds up.

use crate::Plan;
use crate::clients::other_thread;
use crate::connection::{next_frame, open};
use crate::resealer::Resealer;
use crate::server_process::{ChildProcess, ServerProcess, count_failures};
use anyhow::{Context, Result};
use bars::Bar;
use bars::figures::at;
use protocol::chunk_codec::MAGIC;
use serde_json::{Value, json};
use std::env::consts::EXE_SUFFIX;
use std::net::SocketAddr;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use test_support::Random;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};

/// Time between two samples of the memory.
const SAMPLE_INTERVAL: Duration = Duration::from_millis(500);

/// Shortest run with a figure.
const LEAST_SECONDS: u64 = 600;

/// Time limits of one viewer.
const LEAST_VIEW: Duration = Duration::from_secs(1);
const MOST_VIEW: Duration = Duration::from_secs(60);

/// Sessions that a run must reach, and those of the viewer that lives long, which waits up to 10 s
/// before each: fewer show little.
const LEAST_SESSIONS: f64 = 100.0;
const LEAST_CUT_SESSIONS: f64 = 50.0;

/// Time that the viewer may take to give up after its own time limit.
const TIMEOUT: Duration = Duration::from_secs(60);

/// Chunks that the viewer that lives long gets, all in its first session: too few for its view, so
/// that it never ends, and all at the start, so that chunks are no growth.
const FIRST_CHUNKS: usize = 16;

/// One byte in this number is corrupted where single bytes are.
const CORRUPTED: u64 = 20_000;

/// The fault that the proxy adds to a session; the next session gets the next kind.
#[derive(Clone, Copy, Debug)]
enum Kind {
    /// Passes everything, so that the viewer holds chunks.
    Nothing,
    /// Changes single bytes of payloads.
    PayloadBytes,
    /// The same in chunks, which get the digests of their bytes: the viewer decodes them.
    ResealedChunks,
    /// Replaces every fourth payload by random bytes of the same length.
    RandomPayloads,
    /// Repeats every payload, so that the second answers no request.
    Repeated,
    /// Changes single bytes anywhere, lengths and opcodes included.
    StreamBytes,
    /// Random bytes after the answer to the upgrade.
    RandomStream,
    /// Random bytes in place of an answer.
    NoHttp,
    /// Ends the stream in a frame.
    Cut,
    /// Ends the stream in the first chunk, in the first session behind a few chunks.
    CutInChunk,
}

impl Kind {
    /// Those that most viewers meet in turn.
    const ALL: [Self; 9] = [
        Self::Nothing,
        Self::PayloadBytes,
        Self::ResealedChunks,
        Self::RandomPayloads,
        Self::Repeated,
        Self::StreamBytes,
        Self::RandomStream,
        Self::NoHttp,
        Self::Cut,
    ];
}

/// Runs viewers for `plan.seconds`.
pub async fn run(plan: &Plan) -> Result<Value> {
    let server = ServerProcess::start(&plan.launch, &[])?;
    let (listener, sessions) = (TcpListener::bind("127.0.0.1:0").await?, Arc::new(AtomicUsize::new(0)));
    let proxy = listener.local_addr()?;
    let threads = other_thread()?;
    threads.spawn(accept(listener, server.address, Arc::clone(&sessions), &Kind::ALL));
    let (listener, cut) = (TcpListener::bind("127.0.0.1:0").await?, Arc::new(AtomicUsize::new(0)));
    let cutting = listener.local_addr()?;
    threads.spawn(accept(listener, server.address, Arc::clone(&cut), &[Kind::CutInChunk]));

    let folder = std::env::temp_dir().join(format!("tombolo-garbage-{}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    let panics = Arc::new(AtomicU32::new(0));
    let (started, length) = (Instant::now(), Duration::from_secs(plan.seconds));
    let (mut peaks, mut crashes, mut viewers) = (Vec::new(), 0, 0);
    let mut long = viewer(cutting, &folder.join("long.png"), length + TIMEOUT, Arc::clone(&panics))?;
    let mut long_rss = Vec::new();
    while started.elapsed() < length {
        let left = length.saturating_sub(started.elapsed()).clamp(LEAST_VIEW, MOST_VIEW);
        let mut viewer = viewer(proxy, &folder.join("shot.png"), left, Arc::clone(&panics))?;
        let until = Instant::now() + left + TIMEOUT;
        let mut peak = 0;
        while viewer.is_running() && Instant::now() < until {
            tokio::time::sleep(SAMPLE_INTERVAL).await;
            // The process may have ended in between.
            peak = viewer.peak_rss_bytes().map_or(peak, |bytes| bytes.max(peak));
            long_rss.extend(long.rss_bytes().ok().map(|bytes| bytes as f64));
        }
        viewers += 1;
        // 1 is the viewer's own error; a signal, or a viewer that does not end, has no code.
        match viewer.0.try_wait()?.and_then(|status| status.code()) {
            // All of these have done the same; others gave up sooner or later.
            Some(0) => peaks.push(peak as f64),
            Some(1) => {}
            _ => crashes += 1,
        }
    }
    let lasted = started.elapsed().as_secs_f64();
    // One that ended has shown nothing, whatever its code.
    let long_lives = long.is_running();
    threads.shutdown_background();
    let _ = std::fs::remove_dir_all(folder);
    Ok(json!({
        "seconds": plan.seconds,
        "lasted_s": lasted,
        "viewers": viewers,
        "complete": peaks.len(),
        "sessions": sessions.load(Ordering::Relaxed),
        "panics": panics.load(Ordering::Relaxed),
        "crashes": crashes,
        "rss_ratio": growth(&peaks),
        "rss_mib": peaks.last().map(|bytes| bytes / 1_048_576.0),
        "long_lives": long_lives,
        "long_sessions": cut.load(Ordering::Relaxed),
        "long_rss_ratio": growth(&long_rss).filter(|_| long_lives),
        "long_rss_mib": long_rss.last().map(|bytes| bytes / 1_048_576.0),
    }))
}

/// The mean of the last fifth of the values over that of the second fifth; none of fewer than five.
fn growth(samples: &[f64]) -> Option<f64> {
    let fifth = samples.len() / 5;
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let (second, last) = (&samples[fifth..2 * fifth], &samples[samples.len() - fifth..]);
    (fifth > 0).then(|| mean(last) / mean(second))
}

fn viewer(
    server: SocketAddr,
    shot: &std::path::Path,
    timeout: Duration,
    panics: Arc<AtomicU32>,
) -> Result<ChildProcess> {
    let program = std::env::current_exe()?.with_file_name(format!("tombolo-view{EXE_SUFFIX}"));
    let mut child = Command::new(&program)
        .args(["--connect", &format!("ws://{server}/v1/stream"), "--size", "320x180"])
        .args(["--timeout", &timeout.as_secs().to_string(), "--shot"])
        .arg(shot)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .with_context(|| format!("cannot start {}", program.display()))?;
    count_failures(child.stderr.take(), panics);
    Ok(ChildProcess(child))
}

async fn accept(
    listener: TcpListener,
    server: SocketAddr,
    sessions: Arc<AtomicUsize>,
    kinds: &'static [Kind],
) {
    while let Ok((client, _)) = listener.accept().await {
        let number = sessions.fetch_add(1, Ordering::Relaxed);
        let kind = kinds[number % kinds.len()];
        // A session that ends is what the viewer sees.
        tokio::spawn(async move { session(client, server, kind, number as u64).await });
    }
}

async fn session(mut client: TcpStream, server: SocketAddr, kind: Kind, seed: u64) -> Result<()> {
    let chunks = if seed == 0 { FIRST_CHUNKS } else { 0 };
    let mut corruptor = Corruptor::new(kind, Random(seed), chunks);
    if matches!(kind, Kind::NoHttp) {
        client.write_all(&corruptor.random_bytes(4096)).await?;
        return Ok(());
    }
    let mut upstream = open(server).await?;
    let (mut from_client, mut to_client) = client.split();
    let (mut from_server, mut to_server) = upstream.split();
    let down = async {
        let (mut bytes, mut is_open) = (Vec::with_capacity(1 << 17), false);
        loop {
            if from_server.read_buf(&mut bytes).await? == 0 {
                return anyhow::Ok(());
            }
            if !is_open {
                let Some(end) = bytes.windows(4).position(|four| four == b"\r\n\r\n") else { continue };
                to_client.write_all(&bytes[..end + 4]).await?;
                bytes.drain(..end + 4);
                is_open = true;
            }
            let (mut corrupted, mut used, mut goes_on) = (Vec::new(), 0, true);
            while let (true, Some((_, start, end))) = (goes_on, next_frame(&bytes[used..])?) {
                goes_on = corruptor.corrupt(&bytes[used..used + end], start, &mut corrupted);
                used += end;
            }
            bytes.drain(..used);
            to_client.write_all(&corrupted).await?;
            if !goes_on {
                return Ok(());
            }
        }
    };
    tokio::select! {
        ended = down => ended,
        copied = tokio::io::copy(&mut from_client, &mut to_server) => Ok(copied.map(|_| ())?),
    }
}

/// Corrupts frames, the same ones for the same seed.
struct Corruptor {
    kind: Kind,
    random: Random,
    frames: usize,
    /// Chunks that still pass before a cut in a chunk.
    chunks: usize,
    resealer: Resealer,
}

impl Corruptor {
    fn new(kind: Kind, random: Random, chunks: usize) -> Self {
        Self { kind, random, frames: 0, chunks, resealer: Resealer::default() }
    }

    /// Adds what the client gets in place of a frame, whose payload begins at `start`. Whether the
    /// stream goes on.
    fn corrupt(&mut self, frame: &[u8], start: usize, corrupted: &mut Vec<u8>) -> bool {
        self.frames += 1;
        let begin = corrupted.len();
        corrupted.extend_from_slice(frame);
        let added = &mut corrupted[begin..];
        match self.kind {
            Kind::Nothing | Kind::NoHttp => {}
            Kind::PayloadBytes => self.change(&mut added[start..]),
            Kind::ResealedChunks => {
                self.resealer.read(&frame[start..]);
                if frame[start..].starts_with(&MAGIC) {
                    self.change(&mut added[start..]);
                    self.resealer.reseal(&mut added[start..]);
                }
            }
            Kind::StreamBytes => self.change(added),
            Kind::RandomPayloads if self.frames.is_multiple_of(4) => {
                let random = self.random_bytes(added.len() - start);
                added[start..].copy_from_slice(&random);
            }
            Kind::RandomPayloads => {}
            Kind::Repeated => corrupted.extend_from_slice(frame),
            Kind::RandomStream => {
                let random = self.random_bytes(1 << 16);
                corrupted.extend(random);
                return false;
            }
            Kind::Cut if self.frames == 8 => {
                corrupted.truncate(begin + frame.len() / 2);
                return false;
            }
            Kind::Cut => {}
            Kind::CutInChunk if frame[start..].starts_with(&MAGIC) => {
                let Some(left) = self.chunks.checked_sub(1) else {
                    corrupted.truncate(begin + frame.len() / 2);
                    return false;
                };
                self.chunks = left;
            }
            Kind::CutInChunk => {}
        }
        true
    }

    fn change(&mut self, bytes: &mut [u8]) {
        for byte in bytes {
            if self.random.bits().is_multiple_of(CORRUPTED) {
                *byte ^= self.random.bits() as u8;
            }
        }
    }

    fn random_bytes(&mut self, length: usize) -> Vec<u8> {
        (0..length).map(|_| self.random.bits() as u8).collect()
    }
}

/// The bars of this benchmark.
pub fn bars(figures: &Value) -> Vec<Bar> {
    let was_long = at(figures, "seconds").is_some_and(|seconds| seconds >= LEAST_SECONDS as f64)
        && at(figures, "lasted_s") >= at(figures, "seconds");
    let of = |path| at(figures, path).filter(|_| was_long);
    let has_sessions = at(figures, "long_sessions") >= Some(LEAST_CUT_SESSIONS);
    let long = |path| of(path).filter(|_| has_sessions);
    let failures = of("panics").zip(of("crashes")).map(|(panics, crashes)| panics + crashes);
    vec![
        Bar::none("viewers beside a garbage server, 10 min: panics, crashes, GPU errors", failures)
            .with_note(
                "without a window; an unhandled error of the GPU ends a viewer; shorter runs have no figure",
            ),
        Bar::at_most(
            "the same: most memory of a viewer with a complete view, last fifth of them over second",
            of("rss_ratio"),
            "x",
            1.05,
        )
        .with_note("each viewer is a process of its own, so that this shows no leak of one"),
        Bar::at_least("the same: sessions", of("sessions"), "", LEAST_SESSIONS),
        Bar::at_most(
            "one viewer whose sessions are cut: memory, last fifth of its life over second",
            long("long_rss_ratio"),
            "x",
            1.05,
        )
        .with_note(format!(
            "resident memory of one process, every half second; chunks come only in its first session, and \
             with fewer than {LEAST_CUT_SESSIONS} sessions, or if it ended, there is no figure"
        )),
    ]
}

/// Further figures in sentences.
pub fn notes(figures: &Value) -> Vec<String> {
    let line = "Viewers beside a garbage server: {viewers:.0} viewers, {complete:.0} of them with a \
                complete view, {sessions:.0} sessions in {lasted_s:.0} s, \
                {rss_mib:.0} MiB in the last one. One viewer had {long_sessions:.0} sessions that were cut, \
                and {long_rss_mib:.0} MiB in the end.";
    vec![bars::figures::fill(line, figures)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_bars::{check, check_without_peers};
    use protocol::message::{ServerMessage, Welcome};
    use protocol::{ChunkError, chunk_codec, control};
    use terrain::{ChunkKey, Land};

    #[test]
    fn each_bar_can_be_missed() {
        let good = json!({
            "seconds": 600, "lasted_s": 603.0, "sessions": 900, "panics": 0, "crashes": 0, "rss_ratio": 1.01,
            "long_sessions": 900, "long_rss_ratio": 1.01,
        });
        let bad = [
            ("/panics", json!(1)),
            ("/crashes", json!(1)),
            ("/rss_ratio", json!(1.06)),
            ("/sessions", json!(99)),
            ("/long_rss_ratio", json!(1.06)),
            ("/long_rss_ratio", json!(null)),
            ("/long_sessions", json!(49)),
        ];
        check(bars, &good, &bad);
        check_without_peers(bars, &good, "/lasted_s", json!(12.0));
    }

    #[test]
    fn each_kind_corrupts_as_it_says() {
        let frame: Vec<u8> =
            [0x82, 126, 0x9c, 0x40].into_iter().chain((0..40_000).map(|n| n as u8)).collect();
        let corrupted = |kind| {
            let mut corruptor = Corruptor::new(kind, Random(1), 0);
            corruptor.frames = 3;
            let mut bytes = Vec::new();
            let goes_on = corruptor.corrupt(&frame, 4, &mut bytes);
            (bytes, goes_on)
        };
        assert_eq!(corrupted(Kind::Nothing), (frame.clone(), true));
        let changed = |kind| {
            let (bytes, _) = corrupted(kind);
            assert_eq!(bytes.len(), frame.len());
            bytes.iter().zip(&frame).filter(|(a, b)| a != b).count()
        };
        assert!(
            (1..20).contains(&changed(Kind::PayloadBytes)) && (1..20).contains(&changed(Kind::StreamBytes))
        );
        assert!(changed(Kind::RandomPayloads) > 30_000);
        assert_eq!(corrupted(Kind::RandomPayloads).0[..4], frame[..4]);
        assert_eq!(corrupted(Kind::Repeated), ([&frame[..], &frame[..]].concat(), true));
        assert!(!corrupted(Kind::RandomStream).1);
        let mut cut = Corruptor::new(Kind::Cut, Random(1), 0);
        cut.frames = 7;
        let mut bytes = Vec::new();
        assert!(!cut.corrupt(&frame, 4, &mut bytes) && bytes.len() == frame.len() / 2);
    }

    #[test]
    fn a_resealed_chunk_has_other_bytes_and_is_decoded() {
        let land = Land::new(1);
        let key = ChunkKey::new(0, 0, 0).unwrap();
        let chunk = chunk_codec::encode(&land.chunk(key), &land.digest());
        let welcome = ServerMessage::Welcome(Welcome {
            session: 1,
            world_seed: 1,
            generator_version: 1,
            digest: land.digest().0,
            max_credits: 1,
            max_view_distance_m: 1,
            software: String::new(),
        });
        let welcome = control::encode(&welcome).unwrap();
        let framed = |payload: &[u8]| [&[0x82, 126, 0, 0], payload].concat();
        let mut corruptor = Corruptor::new(Kind::ResealedChunks, Random(1), 0);
        let mut bytes = Vec::new();
        assert!(corruptor.corrupt(&framed(&welcome), 4, &mut bytes));
        assert_eq!(bytes, framed(&welcome));
        let decoded = (0..1000).filter_map(|_| {
            bytes.clear();
            assert!(corruptor.corrupt(&framed(&chunk), 4, &mut bytes));
            (bytes[4..] != chunk[..]).then(|| chunk_codec::decode(&bytes[4..], &land.digest()))
        });
        let decoded: Vec<_> = decoded.collect();
        assert!(!decoded.contains(&Err(ChunkError::Digest)));
        assert!(decoded.iter().any(Result::is_ok) && decoded.iter().any(Result::is_err));
    }

    #[test]
    fn growth_compares_the_end_with_the_time_after_the_start() {
        let samples: Vec<f64> =
            (0..50).map(|n| if n < 10 { 1.0 } else { 100.0 + f64::from(n / 40) * 5.0 }).collect();
        assert!((growth(&samples).unwrap() - 1.05).abs() < 1e-9);
        // Of a count that is no multiple of five the end counts all the same.
        let rest: Vec<f64> = (0..9).map(|n| if n < 8 { 1.0 } else { 3.0 }).collect();
        assert_eq!((growth(&rest), growth(&[1.0; 4]), growth(&[])), (Some(3.0), None, None));
    }

    #[test]
    fn a_cut_in_a_chunk_passes_other_frames_and_the_first_chunks() {
        let frame = |payload: &[u8]| [&[0x82, payload.len() as u8], payload].concat();
        let (control, chunk) = (frame(b"welcome"), frame(&[&MAGIC[..], &[1; 16]].concat()));
        let mut cut = Corruptor::new(Kind::CutInChunk, Random(1), 1);
        let mut bytes = Vec::new();
        assert!(cut.corrupt(&control, 2, &mut bytes) && cut.corrupt(&chunk, 2, &mut bytes));
        assert_eq!(bytes, [&control[..], &chunk[..]].concat());
        assert!(!cut.corrupt(&chunk, 2, &mut bytes));
        assert_eq!(bytes.len(), control.len() + chunk.len() + chunk.len() / 2);
    }
}
