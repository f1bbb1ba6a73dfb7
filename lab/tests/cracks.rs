//! A short run of the crack count, with the faults that it must see.

use lab::cracks::{self, Fault};
use terrain::Land;

#[test]
fn no_gap_shows_through_the_land_and_each_fault_shows() {
    let mut studio = match cracks::studio() {
        Ok(studio) => studio,
        Err(error) if std::env::var_os("TOMBOLO_REQUIRE_GPU").is_none() => {
            eprintln!("SKIPPED: {error}");
            return;
        }
        Err(error) => panic!("{error}"),
    };
    let viewpoints = cracks::viewpoints(1, 16, 90);
    let mut count = |fault| cracks::count(&mut studio, Land::new(1), &viewpoints, fault).unwrap();
    let (whole, torn, unjoined) = (count(Fault::None), count(Fault::ChunkLeftOut), count(Fault::NoSeams));
    assert_eq!(whole.magenta, 0, "{:?}", whole.worst);
    assert!(whole.pixels > 200_000 && whole.chunks > 200 && whole.arriving >= 4, "{whole:?}");
    assert!(torn.magenta > 10_000, "{torn:?}");
    assert!(unjoined.magenta >= 10, "{unjoined:?}");
}
