//! The table of docs/heightfield.md against the code.

use terrain::{Land, Octaves, Position};

#[test]
fn every_row_of_the_published_table_is_what_the_code_yields() {
    let page = include_str!("../../docs/heightfield.md");
    let mut rows = 0;
    for line in page.lines().skip_while(|line| !line.starts_with("| seed | x | z | octaves |")).skip(2) {
        let cells: Vec<i128> = line.split('|').filter_map(|cell| cell.trim().parse().ok()).collect();
        let [seed, x, z, kept, hills, folds, height] = cells[..] else { break };
        let (land, octaves) = (Land::new(seed as u64), Octaves::new(kept as usize).unwrap());
        let relief = land.fbm().at(x as i32, z as i32, octaves);
        let position = Position::new(x as i32, z as i32).unwrap();
        assert_eq!((i128::from(relief.hills), i128::from(relief.folds)), (hills, folds), "{line}");
        assert_eq!(i128::from(land.height_keeping(position, octaves)), height, "{line}");
        rows += 1;
    }
    assert_eq!(rows, 16, "rows found in the table");
}
