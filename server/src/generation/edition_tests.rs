//! Tests of editions: no cache confuses two states of a chunk.

use super::test_source::chunk_request;
use super::{Generation, Limits};
use crate::cache::disk::{Disk, DiskConfig, FINEST_LEVEL};
use crate::chunk_id::{ChunkId, Edition};
use crate::metrics::Metrics;
use crate::source::ChunkSource;
use bytes::Bytes;
use protocol::{Delivery, chunk_codec};
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use terrain::constants::VERTEX_COUNT;
use terrain::{Chunk, ChunkKey, GrassSeed, WorldDigest};

const WORLD: WorldDigest = WorldDigest([7; 32]);

/// Flat land at 5 units in the changed edition and at 0 in the base.
struct ChangingSource(Arc<Mutex<Edition>>);

impl ChunkSource for ChangingSource {
    fn world(&self) -> WorldDigest {
        WORLD
    }

    fn edition(&self, _key: ChunkKey) -> Edition {
        *self.0.lock().unwrap()
    }

    fn chunk(&self, id: ChunkId, known_error: Option<u32>) -> Chunk {
        let height = if id.edition.is_base() { 0 } else { 5 };
        let grass = GrassSeed { seed: 0, palette: 0, density: Box::new([0; 256]) };
        Chunk::from_parts(id.key, Box::new([height; VERTEX_COUNT]), known_error.unwrap_or(0), grass)
    }
}

/// A server over a folder, as after a restart, and the edition that it offers.
fn server(folder: &Path) -> (Generation, Arc<Metrics>, Arc<Mutex<Edition>>) {
    let (metrics, edition) = (Arc::new(Metrics::default()), Arc::<Mutex<Edition>>::default());
    let config = DiskConfig { folder: folder.into(), bytes: 64 << 20 };
    let disk = Disk::new(config, &WORLD, Arc::clone(&metrics)).unwrap();
    let deadline = Duration::from_secs(3600);
    let limits = Limits { threads: 1, cache_bytes: 1 << 20, jobs: 100, deadline, without: None };
    let source = ChangingSource(Arc::clone(&edition));
    let service = Generation::with_disk(source, limits, Some(disk), Arc::clone(&metrics)).unwrap();
    (service, metrics, edition)
}

fn height(frame: &Bytes) -> i32 {
    chunk_codec::decode(frame, &WORLD).unwrap().heights[0]
}

#[tokio::test]
async fn a_changed_chunk_is_another_chunk_in_every_cache() {
    let folder = std::env::temp_dir().join(format!("tombolo-editions-{}", std::process::id()));
    let request = chunk_request(ChunkKey::new(FINEST_LEVEL, 1, -1).unwrap(), 1);
    let changed = Edition::changed([9; 16]);
    for (run, made) in [("made", 2), ("read from disk", 0)] {
        let (service, metrics, edition) = server(&folder);
        let base = service.flow().frame(request, Delivery::Exact).await.unwrap();
        *edition.lock().unwrap() = changed;
        assert_eq!(service.cached(request.key, Delivery::Exact), None, "{run}");
        let after = service.flow().frame(request, Delivery::Exact).await.unwrap();
        assert_eq!((height(&base), height(&after)), (0, 5), "{run}");
        // The immutable address keeps the land that the seed makes.
        assert_eq!(service.flow().base_frame(request, Delivery::Exact).await.unwrap(), base, "{run}");
        *edition.lock().unwrap() = Edition::BASE;
        assert_eq!(service.cached(request.key, Delivery::Exact), Some(base), "{run}");
        assert_eq!(metrics.generation.jobs_completed.get(), made, "{run}");
        service.close().await;
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

#[tokio::test]
async fn a_change_while_a_chunk_is_queued_makes_a_second_job() {
    let folder = std::env::temp_dir().join(format!("tombolo-editions-queued-{}", std::process::id()));
    let (service, metrics, edition) = server(&folder);
    let mut flow = service.flow();
    for number in 0..20 {
        let key = ChunkKey::new(0, number, 0).unwrap();
        flow.request(chunk_request(key, 1), Delivery::Exact);
        *edition.lock().unwrap() = Edition::changed([number as u8; 16]);
        flow.request(chunk_request(key, 1), Delivery::Exact);
        *edition.lock().unwrap() = Edition::BASE;
    }
    let mut heights = Vec::new();
    while flow.in_flight() > 0 {
        heights.extend(flow.completions().await.iter().map(|(_, frame)| height(frame.as_ref().unwrap())));
    }
    heights.sort_unstable();
    assert_eq!(heights, [[0; 20], [5; 20]].concat());
    assert_eq!(metrics.generation.jobs_completed.get(), 40);
    service.close().await;
    let _ = std::fs::remove_dir_all(&folder);
}
