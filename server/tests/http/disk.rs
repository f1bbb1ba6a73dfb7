//! The disk cache over restarts of the server.

use crate::client::Server;
use protocol::Delivery;
use protocol::chunk_codec;
use server::ServerConfig;
use server::cache::disk::DiskConfig;
use std::fs;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};
use terrain::{ChunkKey, Land};

const COMPLETED: &str = "generation_jobs_total{outcome=\"completed\"}";
const HITS: &str = "disk_cache_reads_total{outcome=\"hit\"}";
const MISSES: &str = "disk_cache_reads_total{outcome=\"miss\"}";
const WRITTEN: &str = "disk_cache_writes_total{outcome=\"written\"}";
const DROPPED: &str = "disk_cache_writes_total{outcome=\"dropped\"}";
const CORRUPT: &str = "disk_cache_errors_total{reason=\"corrupt\"}";
const IO_ERRORS: &str = "disk_cache_errors_total{reason=\"io\"}";
const UP: &str = "disk_cache_up";

/// A folder per test, removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Self {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("tombolo-http-disk-{}-{number}", std::process::id()));
        fs::create_dir(&path).unwrap();
        Self(path)
    }

    async fn serve(&self, world_seed: u64) -> Server {
        Server::start_with(ServerConfig {
            world_seed,
            threads: 1,
            disk: Some(DiskConfig { folder: self.0.clone(), bytes: 64 << 20 }),
            ..ServerConfig::default()
        })
        .await
    }

    /// The files of frames by name.
    fn frames(&self) -> Vec<PathBuf> {
        let shards = fs::read_dir(&self.0).unwrap().map(|entry| entry.unwrap().path());
        let shards = shards.filter(|path| path.is_dir());
        let mut files: Vec<_> = shards
            .flat_map(|shard| fs::read_dir(shard).unwrap().map(|entry| entry.unwrap().path()))
            .collect();
        files.sort_by_key(|path| path.file_name().map(ToOwned::to_owned));
        files
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// Requests a chunk of a world; its exact frame must be valid.
async fn chunk(server: &Server, world_seed: u64, x: i32) -> Vec<u8> {
    let (land, key) = (Land::new(world_seed), ChunkKey::new(4, x, -1).unwrap());
    let reply = server.get(&format!("/v1/{}/chunk/4/{x}/-1", land.digest())).await;
    assert_eq!(reply.status, 200);
    assert_eq!(chunk_codec::verify(&reply.body, &land.digest()), Ok((key, Delivery::Exact)));
    reply.body
}

async fn metrics<const N: usize>(server: &Server, names: [&str; N]) -> [f64; N] {
    let mut values = [0.0; N];
    for (value, name) in values.iter_mut().zip(names) {
        *value = server.metric(&format!("tombolo_{name}")).await;
    }
    values
}

#[tokio::test]
async fn frames_survive_a_restart_but_not_another_world() {
    let folder = Folder::new();
    let first = folder.serve(1).await;
    let mut frames = Vec::new();
    for x in -2..2 {
        frames.push(chunk(&first, 1, x).await);
    }
    let names = [COMPLETED, HITS, MISSES];
    assert_eq!(metrics(&first, names).await, [4.0, 0.0, 4.0]);
    first.stop().await;
    assert_eq!(folder.frames().len(), 4);

    let second = folder.serve(1).await;
    for (x, frame) in (-2..2).zip(&frames) {
        assert_eq!(&chunk(&second, 1, x).await, frame);
    }
    assert_eq!(metrics(&second, [COMPLETED, HITS]).await, [0.0, 4.0]);
    // The second request is served from memory.
    chunk(&second, 1, 0).await;
    assert_eq!(metrics(&second, ["frame_requests_total{outcome=\"cache_hit\"}", HITS]).await, [1.0, 4.0]);
    second.stop().await;

    let other = folder.serve(2).await;
    assert_ne!(chunk(&other, 2, 0).await, frames[2]);
    assert_eq!(metrics(&other, [COMPLETED, HITS]).await, [1.0, 0.0]);
}

#[tokio::test]
async fn a_corrupt_file_is_deleted_and_generated_again() {
    let folder = Folder::new();
    let first = folder.serve(1).await;
    let (left, right) = (chunk(&first, 1, 0).await, chunk(&first, 1, 1).await);
    first.stop().await;
    let files = folder.frames();
    let Ok([left_file, right_file]) = <[PathBuf; 2]>::try_from(files) else { panic!("two files") };
    assert_eq!(
        (fs::read(&left_file).unwrap(), fs::read(&right_file).unwrap()),
        (left.clone(), right.clone())
    );

    let flipped = |at: usize| {
        let mut bytes = left.clone();
        bytes[at] ^= 1;
        bytes
    };
    // The error, which only the digest protects; the version; the digest; the payload.
    let mut forms = [28, 4, 50, 100, left.len() - 1].map(flipped).to_vec();
    forms.push(left[..left.len() - 1].to_vec());
    forms.push(left[..10].to_vec());
    forms.push(Vec::new());
    forms.push([&left[..], b"x"].concat());
    forms.push(b"not a frame at all".to_vec());
    // Valid frames of another chunk, of another delivery, and of another world.
    forms.push(right.clone());
    let (land, key) = (Land::new(1), ChunkKey::new(4, 0, -1).unwrap());
    let seed = chunk_codec::encode_for(Delivery::SeedOnly, &land.chunk(key), &land.digest());
    forms.push(seed.to_vec());
    let land = Land::new(2);
    forms.push(chunk_codec::encode(&land.chunk(key), &land.digest()).to_vec());

    for form in forms {
        fs::write(&left_file, &form).unwrap();
        let server = folder.serve(1).await;
        assert_eq!(chunk(&server, 1, 0).await, left);
        let names = [COMPLETED, CORRUPT, HITS, "generation_jobs_total{outcome=\"failed\"}"];
        assert_eq!(metrics(&server, names).await, [1.0, 1.0, 0.0, 0.0]);
        server.stop().await;
        assert_eq!(fs::read(&left_file).unwrap(), left, "the new frame is cached again");
    }
}

#[tokio::test]
async fn an_unavailable_folder_does_not_affect_chunks() {
    let folder = Folder::new();
    // A file in the place of a folder, which no user can write to.
    let blocked = Folder::new();
    fs::write(blocked.0.join("file"), "").unwrap();
    let blocked_disk = DiskConfig { folder: blocked.0.join("file/below"), bytes: 64 << 20 };
    let server =
        Server::start_with(ServerConfig { threads: 1, disk: Some(blocked_disk), ..ServerConfig::default() })
            .await;
    chunk(&server, 1, 0).await;
    // The writer thread is asynchronous.
    while metrics(&server, [DROPPED]).await < [1.0] {
        tokio::task::yield_now().await;
    }
    assert_eq!(metrics(&server, [COMPLETED, UP]).await, [1.0, 0.0]);
    assert!(metrics(&server, [IO_ERRORS]).await > [0.0]);
    server.stop().await;

    let server = folder.serve(1).await;
    chunk(&server, 1, 0).await;
    while metrics(&server, [WRITTEN]).await < [1.0] {
        tokio::task::yield_now().await;
    }
    assert_eq!(metrics(&server, [UP, IO_ERRORS]).await, [1.0, 0.0]);
    fs::remove_dir_all(&folder.0).unwrap();
    for x in 1..4 {
        chunk(&server, 1, x).await;
    }
    chunk(&server, 1, 0).await;
    while metrics(&server, [DROPPED]).await < [3.0] {
        tokio::task::yield_now().await;
    }
    assert_eq!(metrics(&server, [UP, COMPLETED]).await, [0.0, 4.0]);
    server.stop().await;
    assert!(!folder.0.exists());
}
