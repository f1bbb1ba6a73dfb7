use super::test_store::{Fault, Faulty};
use super::*;
use crate::bake::{Bake, BakePart};
use crate::generation::{Generation, Limits};
use crate::source::{ChunkSource, ProceduralSource};
use object_store::memory::InMemory;
use object_store::path::Path;
use prometheus_client::metrics::counter::Counter;
use protocol::Delivery;
use protocol::server::ChunkRequest;
use terrain::{ChunkKey, Land};
use tokio_util::sync::CancellationToken;

/// A generation service over a store with a fault.
struct Replica {
    generation: Generation,
    metrics: Arc<Metrics>,
}

const EXACT: &[Delivery] = &[Delivery::Exact];

/// How long a chunk waits for the store: less than a slow store takes, or longer than any machine.
const SHORT: Duration = Duration::from_millis(200);
const LONG: Duration = Duration::from_secs(30);

fn land() -> Land {
    Land::new(1)
}

fn store(objects: &Arc<InMemory>, fault: Fault, metrics: &Arc<Metrics>) -> Store {
    let faulty = Arc::new(Faulty { objects: Arc::clone(objects), fault });
    let wait = if matches!(fault, Fault::Slow) { SHORT } else { LONG };
    Store::over(faulty, &Path::from("root"), wait, &land().digest(), Arc::clone(metrics)).unwrap()
}

/// The land, of which no chunk is cheap: the replicas of a test share the memory of errors.
struct Costly(ProceduralSource);

impl ChunkSource for Costly {
    fn world(&self) -> WorldDigest {
        self.0.world()
    }

    fn chunk(&self, id: ChunkId, known_error: Option<u32>) -> Chunk {
        self.0.chunk(id, known_error)
    }
}

fn replica(objects: &Arc<InMemory>, fault: Fault) -> Replica {
    replica_of(objects, fault, Costly(ProceduralSource::new(land())))
}

fn replica_of(objects: &Arc<InMemory>, fault: Fault, source: impl ChunkSource) -> Replica {
    let metrics = Arc::new(Metrics::default());
    let store = store(objects, fault, &metrics);
    store.scan_regions();
    let limits = Limits {
        threads: 1,
        cache_bytes: 1 << 20,
        jobs: 100,
        deadline: Duration::from_secs(60),
        without: None,
    };
    let generation =
        Generation::with_stores(source, limits, None, Some(store), Arc::clone(&metrics)).unwrap();
    Replica { generation, metrics }
}

fn keys() -> Vec<ChunkKey> {
    (0..8).map(|n| ChunkKey::new(2 + n as u8 % 3, n - 4, 1 - n).unwrap()).collect()
}

/// The replica serves every chunk right in some deliveries. Where one was served, the error is
/// known for another, and the chunk is made without the store.
async fn serves(replica: &Replica, keys: &[ChunkKey], deliveries: &[Delivery]) {
    let (land, world) = (land(), land().digest());
    for key in keys {
        for delivery in deliveries.iter().copied() {
            let request = ChunkRequest { key: *key, request: Some(0), priority: 0 };
            let frame = replica.generation.flow().compact().frame(request, delivery).await.unwrap();
            assert_eq!(
                frame,
                chunk_codec::encode_for(delivery, &land.chunk(*key), &world),
                "{key} {delivery}"
            );
        }
    }
    replica.generation.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_one_replica_makes_another_reads() {
    let objects = Arc::new(InMemory::new());
    let first = replica(&objects, Fault::None);
    serves(&first, &keys(), EXACT).await;
    assert_eq!((first.metrics.generation.jobs_completed.get(), first.metrics.store.writes.get()), (8, 8));
    let second = replica(&objects, Fault::None);
    serves(&second, &keys(), EXACT).await;
    assert_eq!((second.metrics.generation.jobs_completed.get(), second.metrics.store.hits.get()), (0, 8));
    // Another delivery is encoded from the chunk of the store.
    let third = replica(&objects, Fault::None);
    serves(&third, &keys(), &[Delivery::SeedOnly]).await;
    assert_eq!((third.metrics.generation.jobs_completed.get(), third.metrics.store.hits.get()), (0, 8));
    // Fine levels are cheaper to make than to read.
    let fine = ChunkKey::new(0, 1, 1).unwrap();
    serves(&second, &[fine], EXACT).await;
    assert_eq!((second.metrics.generation.jobs_completed.get(), second.metrics.store.writes.get()), (1, 0));
}

#[tokio::test(flavor = "multi_thread")]
async fn no_fault_of_a_store_changes_a_chunk() {
    let objects = Arc::new(InMemory::new());
    serves(&replica(&objects, Fault::None), &keys(), EXACT).await;
    for fault in [Fault::Slow, Fault::Gone, Fault::Damaged, Fault::Foreign, Fault::Cut, Fault::ReadOnly] {
        let seed_only = replica(&objects, fault);
        serves(&seed_only, &keys(), &[Delivery::SeedOnly, Delivery::Exact]).await;
        let replica = replica(&objects, fault);
        serves(&replica, &keys(), EXACT).await;
        let metrics = &replica.metrics;
        let made = metrics.generation.jobs_completed.get();
        let [invalid, late, failed, skipped, refused] = [
            &metrics.store.reads_invalid,
            &metrics.store.reads_late,
            &metrics.store.reads_failed,
            &metrics.store.reads_skipped,
            &metrics.store.writes_refused,
        ]
        .map(Counter::get);
        match fault {
            Fault::Slow => assert!(late == 1 && skipped == 7 && made == 8, "{late} late, {skipped} skipped"),
            Fault::Gone => assert!(failed <= 5 && failed + skipped == 8 && made == 8, "{failed} failed"),
            Fault::ReadOnly => assert_eq!((metrics.store.hits.get(), made, refused), (8, 0, 0)),
            // Reads of both threads may be under way when the third is invalid.
            _ => {
                assert!((3..=4).contains(&invalid), "{fault:?}: {invalid} invalid");
                assert_eq!((made, invalid + skipped), (8, 8), "{fault:?}");
            }
        }
    }
}

/// The selection of a view measures the errors of its chunks before they are made: they are made
/// faster than they are read. The control is a source that makes none faster.
#[tokio::test(flavor = "multi_thread")]
async fn chunks_whose_error_is_remembered_are_written_and_not_read() {
    let objects = Arc::new(InMemory::new());
    keys().into_iter().for_each(|key| _ = land().error_of(key));
    for (is_cheap, hits, made) in [(true, 0, 8), (true, 0, 8), (false, 8, 0)] {
        let source = ProceduralSource::new(land());
        let replica = match is_cheap {
            true => replica_of(&objects, Fault::None, source),
            false => replica_of(&objects, Fault::None, Costly(source)),
        };
        serves(&replica, &keys(), EXACT).await;
        let metrics = &replica.metrics;
        assert_eq!((metrics.store.hits.get(), metrics.store.misses.get()), (hits, 0));
        assert_eq!((metrics.generation.jobs_completed.get(), metrics.store.writes.get()), (made, made));
    }
}

/// Reads without a result may take a part of the time of chunks that were looked for.
#[tokio::test(flavor = "multi_thread")]
async fn chunks_that_are_not_read_earn_no_time_for_reads() {
    let objects = Arc::new(InMemory::new());
    let store = store(&objects, Fault::None, &Arc::default());
    let [fine, coarse] = [0, 3].map(|level| ChunkId::base(ChunkKey::new(level, 0, 0).unwrap()));
    let now = Instant::now();
    let is_read = || store.inner.pace.wait(coarse.key, false, now).is_some();
    store.inner.pace.useless(LONG);
    assert!(is_read() && !is_read(), "one try");
    for _ in 0..100 {
        store.made(fine, LONG);
    }
    assert!(!is_read());
    for _ in 0..100 {
        store.made(coarse, LONG);
    }
    assert!(is_read(), "the control");
}

/// Replicas do not spend more on sharing chunks than on making them.
#[tokio::test(flavor = "multi_thread")]
async fn chunks_that_would_not_be_read_are_not_written() {
    let objects = Arc::new(InMemory::new());
    let replica = replica(&objects, Fault::Slow);
    serves(&replica, &keys(), EXACT).await;
    let metrics = &replica.metrics;
    assert_eq!((metrics.store.writes_skipped.get(), metrics.store.reads_late.get()), (8, 1));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_store_that_refuses_writes_is_read() {
    let objects = Arc::new(InMemory::new());
    let replica = replica(&objects, Fault::ReadOnly);
    serves(&replica, &keys(), EXACT).await;
    let [refused, dropped, written] = [
        &replica.metrics.store.writes_refused,
        &replica.metrics.store.writes_dropped,
        &replica.metrics.store.writes,
    ]
    .map(Counter::get);
    // Those in flight at the first refusal are refused, too; the others wait for a minute.
    assert!(refused >= 1 && refused + dropped == 8 && written == 0, "{refused} refused, {dropped} dropped");
    assert_eq!(replica.metrics.store.up.get(), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_store_that_may_not_be_listed_is_read_and_written() {
    let objects = Arc::new(InMemory::new());
    for (hits, misses) in [(0, 8), (8, 0)] {
        let replica = replica(&objects, Fault::Unlisted);
        serves(&replica, &keys(), EXACT).await;
        let metrics = &replica.metrics;
        assert_eq!((metrics.store.hits.get(), metrics.store.misses.get()), (hits, misses));
        assert_eq!((metrics.store.writes.get(), metrics.store.reads_failed.get()), (misses, 0));
        assert_eq!(metrics.store.up.get(), 1);
    }
}

/// The control is a list that ends only after the wait for it.
#[tokio::test(flavor = "multi_thread")]
async fn a_store_is_ready_after_its_first_scan_regions_or_after_a_wait() {
    let start = Instant::now();
    for fault in [Fault::None, Fault::Unlisted] {
        let store = store(&Arc::default(), fault, &Arc::default());
        timeout(LONG, async {
            while !store.is_ready(start) {
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
        })
        .await
        .unwrap();
    }
    let store = store(&Arc::default(), Fault::Silent, &Arc::default());
    let ready_by = store.inner.ready_by;
    assert!(ready_by >= start + FIRST_SCAN_TIMEOUT);
    assert!(!store.is_ready(ready_by - Duration::from_millis(1)) && store.is_ready(ready_by));
}

/// The control is that the first chunks are written without result: the breaker of the writes is
/// open, and that of the reads is not.
#[tokio::test(flavor = "multi_thread")]
async fn a_full_store_is_read() {
    let objects = Arc::new(InMemory::new());
    serves(&replica(&objects, Fault::None), &keys(), EXACT).await;
    let replica = replica(&objects, Fault::Full);
    let others: Vec<_> = (0..12).map(|n| ChunkKey::new(2, 20 + n, 5).unwrap()).collect();
    serves(&replica, &others, EXACT).await;
    let metrics = &replica.metrics;
    let (failed, dropped) = (metrics.store.writes_failed.get(), metrics.store.writes_dropped.get());
    assert!(failed >= 5 && failed + dropped == 12, "{failed} failed, {dropped} dropped");
    serves(&replica, &keys(), EXACT).await;
    assert_eq!((metrics.store.hits.get(), metrics.generation.jobs_completed.get()), (8, 12));
    assert_eq!(metrics.store.up.get(), 1);
}

/// The control is an object as long as a frame may be: it is read, and is none.
#[tokio::test(flavor = "multi_thread")]
async fn an_object_longer_than_any_frame_is_invalid_and_not_read() {
    for (length, read) in [(MAX_CHUNK_FRAME, MAX_CHUNK_FRAME), (MAX_CHUNK_FRAME + 1, 0)] {
        let objects = Arc::new(InMemory::new());
        let metrics = Arc::new(Metrics::default());
        let store = store(&objects, Fault::None, &metrics);
        let id = ChunkId::base(ChunkKey::new(3, 0, 0).unwrap());
        objects.put(&store.inner.names.chunk(id), vec![7; length].into()).await.unwrap();
        let Ok(Fetched::Object(bytes)) = store.inner.get(id, None).await else { panic!("no object") };
        assert_eq!(bytes.len(), read);
        assert!(tokio::task::spawn_blocking(move || store.read(id)).await.unwrap().is_none());
        assert_eq!(metrics.store.reads_invalid.get(), 1, "{length}");
    }
}

/// A read without an answer takes longer than the timeout.
#[test]
fn the_timeout_of_a_read_is_a_bound_of_its_histogram() {
    let metrics = Metrics::default();
    for took in [READ_TIMEOUT, READ_TIMEOUT + Duration::from_millis(1)] {
        metrics.store.read_seconds.observe(took.as_secs_f64());
    }
    let bound = READ_TIMEOUT.as_secs_f64();
    let bucket = format!("tombolo_store_read_duration_seconds_bucket{{le=\"{bound:?}\"}} 1\n");
    let text = metrics.render();
    assert!(text.contains(&bucket), "{bucket} is not in {text}");
}

/// Threads that wait for the store are bounded: one more read is skipped, and its chunk is made.
#[tokio::test(flavor = "multi_thread")]
async fn one_read_more_than_may_be_in_flight_is_skipped() {
    let objects = Arc::new(InMemory::new());
    serves(&replica(&objects, Fault::None), &keys(), EXACT).await;
    let metrics = Arc::new(Metrics::default());
    let store = Arc::new(store(&objects, Fault::None, &metrics));
    let read = || {
        let (store, id) = (Arc::clone(&store), ChunkId::base(keys()[0]));
        tokio::task::spawn_blocking(move || store.read(id).is_some())
    };
    let others = Arc::clone(&store.inner.reads).acquire_many_owned(READS_IN_FLIGHT as u32).await.unwrap();
    assert!(!read().await.unwrap());
    assert_eq!(metrics.store.reads_skipped.get(), 1);
    drop(others);
    assert!(read().await.unwrap(), "the control");
    assert_eq!(metrics.store.reads_skipped.get(), 1);
}

/// A bake of a small region into these objects.
async fn bake(objects: &Arc<InMemory>, region: &BakedRegion) {
    let bake = Bake {
        names: ObjectNames::new(&Path::from("root"), &land().digest()),
        land: land(),
        region: region.clone(),
        part: BakePart { index: 0, of: 1 },
        objects: Arc::<InMemory>::clone(objects),
        threads: None,
    };
    assert!(bake.run(&CancellationToken::new(), |_, _| ()).await.unwrap().is_complete);
}

/// Chunks of packs that cannot be read are made once, written as objects of their own, and read.
#[tokio::test(flavor = "multi_thread")]
async fn chunks_of_a_lost_pack_become_objects_of_their_own() {
    let objects = Arc::new(InMemory::new());
    let region = BakedRegion::new(&(3..=3), [-100, -100, 100, 100]).unwrap();
    bake(&objects, &region).await;
    let names = ObjectNames::new(&Path::from("root"), &land().digest());
    for tile in region.tiles() {
        objects.delete(&names.pack(tile)).await.unwrap();
    }
    let keys: Vec<_> = (0..8).map(|n| ChunkKey::new(3, n % 2 - 1, n / 2 - 2).unwrap()).collect();
    for made in [8, 0] {
        let replica = replica(&objects, Fault::None);
        serves(&replica, &keys, EXACT).await;
        assert_eq!(replica.metrics.generation.jobs_completed.get(), made);
    }
}

/// No server writes an object of such a chunk: it is looked for once, in the pack.
#[tokio::test(flavor = "multi_thread")]
async fn chunks_of_a_lost_pack_finer_than_all_stored_levels_are_only_made() {
    let objects = Arc::new(InMemory::new());
    let region = BakedRegion::new(&(1..=1), [-100, -100, 100, 100]).unwrap();
    bake(&objects, &region).await;
    let names = ObjectNames::new(&Path::from("root"), &land().digest());
    for tile in region.tiles() {
        objects.delete(&names.pack(tile)).await.unwrap();
    }
    let metrics = Arc::new(Metrics::default());
    let store = Arc::new(store(&objects, Fault::None, &metrics));
    store.scan_regions();
    let id = ChunkId::base(ChunkKey::new(1, 0, 0).unwrap());
    let tile = PackTile::of(id.key).0;
    // Were it there, it would be read.
    objects
        .put(&names.chunk(id), chunk_codec::encode(&land().chunk(id.key), &land().digest()).into())
        .await
        .unwrap();
    for _ in 0..3 {
        let store = Arc::clone(&store);
        assert!(tokio::task::spawn_blocking(move || store.read(id)).await.unwrap().is_none());
    }
    assert_eq!(metrics.store.misses.get(), 1);
    assert!(store.inner.packed(id) == Some(tile) && store.inner.whole_pack(id).is_none());
}

/// Damaged packs are no failure of the store: chunks of others are read on.
#[tokio::test(flavor = "multi_thread")]
async fn damaged_and_cut_packs_are_invalid_and_open_no_breaker() {
    let objects = Arc::new(InMemory::new());
    let region = BakedRegion::new(&(3..=4), [-100, -100, 100, 100]).unwrap();
    bake(&objects, &region).await;
    let names = ObjectNames::new(&Path::from("root"), &land().digest());
    for tile in region.tiles().filter(|tile| tile.level == 3) {
        let pack = objects.get(&names.pack(tile)).await.unwrap().bytes().await.unwrap();
        let damaged = match tile.x {
            0 => pack[..pack.len() / 2].to_vec(),
            _ => [&pack[..pack::HEADER], &vec![7; pack.len() - pack::HEADER]].concat(),
        };
        objects.put(&names.pack(tile), damaged.into()).await.unwrap();
    }
    let replica = replica(&objects, Fault::None);
    let [damaged, whole] = [3, 4]
        .map(|level| (0..8).map(|n| ChunkKey::new(level, n % 2 - 1, n / 2 - 2).unwrap()).collect::<Vec<_>>());
    serves(&replica, &damaged, EXACT).await;
    serves(&replica, &whole, EXACT).await;
    let metrics = &replica.metrics;
    assert_eq!((metrics.generation.jobs_completed.get(), metrics.store.hits.get()), (8, 8));
    // Of each of the four packs one read is invalid; the four others look for an object of the
    // chunk's own. Each read in time has one outcome.
    assert_eq!((metrics.store.reads_invalid.get(), metrics.store.misses.get()), (4, 4));
    assert_eq!(metrics.store.reads_failed.get(), 0);
}

/// A region whose object is damaged would hide the chunks of the area that it states.
#[tokio::test(flavor = "multi_thread")]
async fn a_region_with_the_name_of_another_is_ignored() {
    let objects = Arc::new(InMemory::new());
    let region = BakedRegion::new(&(3..=3), [-100, -100, 100, 100]).unwrap();
    let names = ObjectNames::new(&Path::from("root"), &land().digest());
    let larger = BakedRegion::new(&(2..=3), [-100, -100, 100, 100]).unwrap();
    let path = names.regions().join(region.name());
    objects.put(&path, serde_json::to_vec(&larger).unwrap().into()).await.unwrap();
    let metrics = Arc::new(Metrics::default());
    let store = store(&objects, Fault::None, &metrics);
    store.scan_regions();
    assert!(store.inner.packed(ChunkId::base(ChunkKey::new(2, 0, 0).unwrap())).is_none());
    // The control: with its own name it is used.
    objects
        .put(&names.regions().join(larger.name()), serde_json::to_vec(&larger).unwrap().into())
        .await
        .unwrap();
    store.scan_regions();
    assert!(store.inner.packed(ChunkId::base(ChunkKey::new(2, 0, 0).unwrap())).is_some());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_baked_region_is_served_without_making_a_chunk() {
    let objects = Arc::new(InMemory::new());
    let region = BakedRegion::new(&(1..=3), [-3_000, -3_000, 3_000, 3_000]).unwrap();
    bake(&objects, &region).await;
    let replica = replica(&objects, Fault::None);
    let keys: Vec<_> =
        (0..48).map(|n| ChunkKey::new(1 + n as u8 % 3, n % 7 - 3, n / 7 - 3).unwrap()).collect();
    assert!(keys.iter().all(|key| region.contains(PackTile::of(*key).0)));
    serves(&replica, &keys, EXACT).await;
    assert_eq!((replica.metrics.generation.jobs_completed.get(), replica.metrics.store.writes.get()), (0, 0));
    // The control: beyond the region it is made.
    serves(&replica, &[ChunkKey::new(1, 900, 900).unwrap()], EXACT).await;
    assert_eq!(replica.metrics.generation.jobs_completed.get(), 1);
}
