use super::*;
use crate::store::test_store::{Fault, Faulty};
use object_store::memory::InMemory;
use std::collections::BTreeMap;

const SEED: u64 = 1;

/// A small region: 2 levels over 4 tiles and 1.
fn bake(objects: &Arc<InMemory>, index: u64, of: u64) -> Bake {
    let land = Land::new(SEED);
    Bake {
        names: ObjectNames::new(&Path::from("store"), &land.digest()),
        land,
        region: BakedRegion::new(&(4..=5), [-1, -1, 40_000, 40_000]).unwrap(),
        part: BakePart { index, of },
        objects: Arc::<InMemory>::clone(objects),
        threads: None,
    }
}

/// Every object with the hash of its content.
async fn contents(objects: &InMemory) -> BTreeMap<String, blake3::Hash> {
    let all: Vec<_> = objects.list(None).try_collect().await.unwrap();
    let mut contents = BTreeMap::new();
    for object in all {
        let bytes = objects.get(&object.location).await.unwrap().bytes().await.unwrap();
        contents.insert(object.location.to_string(), blake3::hash(&bytes));
    }
    contents
}

#[tokio::test]
async fn any_number_of_parts_gives_the_same_objects_also_when_one_is_stopped_and_repeated() {
    let whole = Arc::new(InMemory::new());
    let baked = bake(&whole, 0, 1).run(&CancellationToken::new(), |_, _| ()).await.unwrap();
    let expected = contents(&whole).await;
    assert_eq!(expected.len() as u64, baked.packs + 1, "packs and the region");
    assert!(baked.is_complete && baked.packs >= 8 && baked.kept == 0);
    for of in [2, 7] {
        let objects = Arc::new(InMemory::new());
        // Stopped within its part: after some packs.
        let stopped = bake(&objects, 1, of);
        let mut packs = 0;
        let unused = CancellationToken::new();
        let stop = stopped.run(&unused, |_, _| {
            packs += 1;
            assert!(packs < 2, "stopped");
        });
        let stopped = futures_util::FutureExt::catch_unwind(std::panic::AssertUnwindSafe(stop)).await;
        // Seven parts have one or two packs each; half of them have more.
        assert_eq!(stopped.is_err(), packs == 2);
        assert!(of != 2 || packs == 2, "nothing was stopped");
        assert!(!contents(&objects).await.keys().any(|name| name.contains("regions")));
        for index in (0..of).rev() {
            let baked = bake(&objects, index, of).run(&CancellationToken::new(), |_, _| ()).await.unwrap();
            assert_eq!(baked.is_complete, index == 0, "part {index} of {of}");
        }
        assert_eq!(contents(&objects).await, expected, "{of} parts");
    }
}

#[tokio::test]
async fn a_repeated_bake_keeps_valid_packs_and_replaces_damaged_ones() {
    let objects = Arc::new(InMemory::new());
    let first = bake(&objects, 0, 1);
    let baked = first.run(&CancellationToken::new(), |_, _| ()).await.unwrap();
    let expected = contents(&objects).await;
    let tile = first.region.tiles().next().unwrap();
    objects.put(&first.names.pack(tile), "damaged".into()).await.unwrap();
    let again = bake(&objects, 0, 1).run(&CancellationToken::new(), |_, _| ()).await.unwrap();
    assert_eq!((again.written, again.kept), (1, baked.packs - 1));
    assert_eq!(contents(&objects).await, expected);
}

#[tokio::test]
async fn a_stopped_bake_ends_after_what_it_has_begun_and_goes_on_when_it_is_repeated() {
    let objects = Arc::new(InMemory::new());
    let stop = CancellationToken::new();
    // Two packs at least are not begun yet when the first is written.
    let stopped = bake(&objects, 0, 1).run(&stop, |_, _| stop.cancel()).await.unwrap();
    assert!(stopped.is_stopped && !stopped.is_complete);
    assert!((1..=PUTS_IN_FLIGHT as u64 + 1).contains(&stopped.written), "{stopped:?}");
    assert_eq!(contents(&objects).await.len() as u64, stopped.written, "none was lost");
    let again = bake(&objects, 0, 1).run(&CancellationToken::new(), |_, _| ()).await.unwrap();
    assert_eq!((again.kept, again.is_complete, again.is_stopped), (stopped.written, true, false));
}

#[tokio::test]
async fn a_pack_counts_when_the_store_has_taken_it() {
    let mut bake = bake(&Arc::default(), 0, 1);
    let open = |bake: &mut Bake, name| {
        let folder = std::env::temp_dir().join(format!("tombolo-bake-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (objects, root) = StoreAddress::parse(folder.to_str().unwrap()).unwrap().open().unwrap();
        (bake.names, bake.objects) = (ObjectNames::new(&root, &bake.land.digest()), objects);
        folder
    };
    let folder = open(&mut bake, "blocked");
    // A folder in the place of a pack: there is no such object, and none can be written.
    for tile in bake.region.tiles().skip(1) {
        std::fs::create_dir_all(std::path::Path::new("/").join(bake.names.pack(tile).as_ref())).unwrap();
    }
    let mut seen = Vec::new();
    let failed =
        bake.run(&CancellationToken::new(), |baked, _| seen.push((baked.packs, baked.written))).await;
    let _ = std::fs::remove_dir_all(&folder);
    assert!(failed.unwrap_err().contains("the store failed"));
    // The one that can be written may come after the first that cannot.
    assert!(seen.iter().all(|counts| *counts == (1, 1)), "{seen:?}");
    // The control: where all can be written, all count. In another folder: a write that was begun
    // may still end in the first one.
    let folder = open(&mut bake, "free");
    let mut seen = Vec::new();
    let baked = bake
        .run(&CancellationToken::new(), |baked, _| seen.push((baked.packs, baked.written)))
        .await
        .unwrap();
    let _ = std::fs::remove_dir_all(&folder);
    assert!(baked.packs > 2 && seen.last() == Some(&(baked.packs, baked.packs)), "{seen:?}");
}

/// S3 without the right to list refuses reads of absent objects: a bake writes them and completes.
/// Controls: a client that may not read at all completes nothing, and one that may not write fails.
#[tokio::test]
async fn a_bake_without_the_right_to_list_completes() {
    let run = async |fault| {
        let objects = Arc::new(InMemory::new());
        let mut bake = bake(&objects, 0, 1);
        bake.objects = Arc::new(Faulty { objects, fault });
        bake.run(&CancellationToken::new(), |_, _| ()).await
    };
    let unlisted = run(Fault::Unlisted).await.unwrap();
    assert!(unlisted.is_complete && unlisted.refused == unlisted.packs, "{unlisted:?}");
    let unread = run(Fault::WriteOnly).await.unwrap();
    assert!(!unread.is_complete && unread.refused == unread.packs + 1, "{unread:?}");
    assert_eq!(unread.written, unlisted.written);
    let unwritten = run(Fault::ReadOnly).await.unwrap_err();
    assert!(unwritten.contains("the right to put"), "{unwritten}");
    assert_eq!(run(Fault::None).await.unwrap().refused, 0);
}

#[test]
fn options_are_checked() {
    assert_eq!(levels("2-5"), Ok(2..=5));
    assert_eq!(area("-1, 2,3,4"), Ok(BakeArea([-1, 2, 3, 4])));
    assert_eq!(part("3/4"), Ok(BakePart { index: 3, of: 4 }));
    for wrong in ["", "5-2", "1-17", "a"] {
        assert!(levels(wrong).is_err(), "{wrong}");
    }
    for wrong in ["", "4/4", "1", "-1/2", "1/0"] {
        assert!(part(wrong).is_err(), "{wrong}");
    }
    for wrong in ["", "1,2,3", "1,2,3,4,5", "1,2,3,x"] {
        assert!(area(wrong).is_err(), "{wrong}");
    }
}
