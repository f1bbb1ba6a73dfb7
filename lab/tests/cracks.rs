//! The crack count, and short runs with each injected fault.

use lab::cracks::{self, Fault};
use terrain::Land;

#[test]
fn no_crack_is_visible_and_each_fault_is() {
    let mut renderer = match cracks::renderer() {
        Ok(renderer) => renderer,
        Err(error) if std::env::var_os("TOMBOLO_REQUIRE_GPU").is_none() => {
            eprintln!("SKIPPED: {error}");
            return;
        }
        Err(error) => panic!("{error}"),
    };
    let viewpoints = cracks::viewpoints(1, 200, 90);
    let mut count =
        |viewpoints, fault| cracks::count(&mut renderer, Land::new(1), viewpoints, fault).unwrap();
    let whole = count(&viewpoints, Fault::None);
    assert_eq!(whole.magenta, 0, "{:?}", whole.worst);
    assert!(whole.pixels > 2_500_000 && whole.chunks > 2_500 && whole.arriving >= 50, "{whole:?}");
    let (torn, unjoined) =
        (count(&viewpoints[..16], Fault::ChunkLeftOut), count(&viewpoints[..16], Fault::NoSeams));
    assert!(torn.magenta > 10_000, "{torn:?}");
    assert!(unjoined.magenta >= 10, "{unjoined:?}");
}
