//! Servers one after the other over the same folder.

use crate::client::Server;
use protocol::Delivery;
use protocol::chunk_codec;
use server::ServerConfig;
use server::disk::DiskConfig;
use std::fs;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};
use terrain::{ChunkKey, Land};

/// A folder of its own for each, removed at the end.
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

    /// The files of frames, in the order of their names' ends.
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

/// Asks for a chunk of a world and gives its exact frame, which must be whole.
async fn chunk(server: &Server, world_seed: u64, x: i32) -> Vec<u8> {
    let (land, key) = (Land::new(world_seed), ChunkKey::new(4, x, -1).unwrap());
    let reply = server.get(&format!("/v1/{}/chunk/4/{x}/-1", land.digest())).await;
    assert_eq!(reply.status, 200);
    assert_eq!(chunk_codec::verify(&reply.body, &land.digest()), Ok((key, Delivery::Exact)));
    reply.body
}

async fn counts<const N: usize>(server: &Server, names: [&str; N]) -> [f64; N] {
    let mut values = [0.0; N];
    for (value, name) in values.iter_mut().zip(names) {
        *value = server.metric(&format!("tombolo_{name}")).await;
    }
    values
}

#[tokio::test]
async fn a_server_finds_again_what_the_one_before_it_made_and_another_world_does_not() {
    let folder = Folder::new();
    let first = folder.serve(1).await;
    let mut made = Vec::new();
    for x in -2..2 {
        made.push(chunk(&first, 1, x).await);
    }
    let names = ["generated_total", "disk_hits_total", "disk_misses_total"];
    assert_eq!(counts(&first, names).await, [4.0, 0.0, 4.0]);
    first.stop().await;
    assert_eq!(folder.frames().len(), 4);

    let second = folder.serve(1).await;
    for (x, frame) in (-2..2).zip(&made) {
        assert_eq!(&chunk(&second, 1, x).await, frame);
    }
    assert_eq!(counts(&second, ["generated_total", "disk_hits_total"]).await, [0.0, 4.0]);
    // From memory the second time.
    chunk(&second, 1, 0).await;
    assert_eq!(counts(&second, ["cache_hits_total", "disk_hits_total"]).await, [1.0, 4.0]);
    second.stop().await;

    let other = folder.serve(2).await;
    assert_ne!(chunk(&other, 2, 0).await, made[2]);
    assert_eq!(counts(&other, ["generated_total", "disk_hits_total"]).await, [1.0, 0.0]);
}

#[tokio::test]
async fn a_frame_that_is_not_what_it_was_is_deleted_and_made_again_and_nobody_notices() {
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
    // The error, which nothing but the digest protects; the version; the digest itself; the
    // payload.
    let mut forms = [28, 4, 50, 100, left.len() - 1].map(flipped).to_vec();
    forms.push(left[..left.len() - 1].to_vec());
    forms.push(left[..10].to_vec());
    forms.push(Vec::new());
    forms.push([&left[..], b"x"].concat());
    forms.push(b"not a frame at all".to_vec());
    // Whole, but another chunk's, for another delivery, and another world's.
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
        let names = ["generated_total", "disk_damaged_total", "disk_hits_total", "failed_total"];
        assert_eq!(counts(&server, names).await, [1.0, 1.0, 0.0, 0.0]);
        server.stop().await;
        assert_eq!(fs::read(&left_file).unwrap(), left, "what was made again is kept again");
    }
}

#[tokio::test]
async fn a_folder_that_cannot_be_used_or_vanishes_costs_no_chunk() {
    let folder = Folder::new();
    // A file where a folder should be: nobody can write below it, whatever his rights.
    let blocked = Folder::new();
    fs::write(blocked.0.join("file"), "").unwrap();
    let blocked_disk = DiskConfig { folder: blocked.0.join("file/below"), bytes: 64 << 20 };
    let server =
        Server::start_with(ServerConfig { threads: 1, disk: Some(blocked_disk), ..ServerConfig::default() })
            .await;
    chunk(&server, 1, 0).await;
    // The thread that writes may not have got so far.
    while server.metric("tombolo_disk_dropped_total").await < 1.0 {
        tokio::task::yield_now().await;
    }
    assert_eq!(counts(&server, ["generated_total", "disk_working"]).await, [1.0, 0.0]);
    assert!(server.metric("tombolo_disk_faults_total").await > 0.0);
    server.stop().await;

    let server = folder.serve(1).await;
    chunk(&server, 1, 0).await;
    while server.metric("tombolo_disk_writes_total").await < 1.0 {
        tokio::task::yield_now().await;
    }
    assert_eq!(counts(&server, ["disk_working", "disk_faults_total"]).await, [1.0, 0.0]);
    fs::remove_dir_all(&folder.0).unwrap();
    for x in 1..4 {
        chunk(&server, 1, x).await;
    }
    chunk(&server, 1, 0).await;
    while server.metric("tombolo_disk_dropped_total").await < 3.0 {
        tokio::task::yield_now().await;
    }
    assert_eq!(counts(&server, ["disk_working", "generated_total"]).await, [0.0, 4.0]);
    server.stop().await;
    assert!(!folder.0.exists());
}
