use super::*;
use proptest::prelude::*;

fn small_grid() -> PointGrid {
    let points = (0..6)
        .map(|i| {
            let t = i as f32;
            if i == 3 { [f32::NAN; 3] } else { [t, -0.5 * t, 0.25] }
        })
        .collect();
    PointGrid::new(2, 3, points)
}

fn same(a: &PointGrid, b: &PointGrid) -> bool {
    let cell = |grid: &PointGrid, i: usize| grid.point(i / grid.columns(), i % grid.columns());
    (a.rows(), a.columns()) == (b.rows(), b.columns())
        && (0..a.points().len()).all(|i| cell(a, i) == cell(b, i))
}

fn with_header(lines: &str, body: &[u8]) -> Vec<u8> {
    [lines.as_bytes(), body].concat()
}

#[test]
fn every_encoding_gives_the_grid_back() {
    for encoding in [Encoding::Ascii, Encoding::Binary, Encoding::BinaryCompressed] {
        let bytes = write_pcd(&small_grid(), encoding);
        let grid = read_pcd(&bytes).unwrap().into_grid().unwrap();
        assert!(same(&grid, &small_grid()), "{encoding:?}");
    }
}

#[test]
fn fields_may_stand_in_any_order_among_others() {
    let bytes = with_header(
        "# a remark\nVERSION 0.7\nFIELDS rgb z normal x y\nSIZE 4 8 4 4 2\nTYPE U F F F I\n\
         COUNT 1 1 3 1 1\nWIDTH 1\nHEIGHT 2\nPOINTS 2\nDATA ascii\n",
        b"7 3.5 0 0 1 1.5 -2\n9 nan 0 0 1 nan nan",
    );
    let grid = read_pcd(&bytes).unwrap().into_grid().unwrap();
    assert_eq!(grid.points()[0], [1.5, -2.0, 3.5]);
    assert!(grid.point(1, 0).is_none());
}

#[test]
fn binary_records_hold_doubles_and_integers_too() {
    let mut body = Vec::new();
    for (x, y, z) in [(1.25_f64, -3_i16, 200_u8), (2.5, 4, 0)] {
        body.extend_from_slice(&z.to_le_bytes());
        body.extend_from_slice(&x.to_le_bytes());
        body.extend_from_slice(&y.to_le_bytes());
    }
    let head = "FIELDS z x y\nSIZE 1 8 2\nTYPE U F I\nWIDTH 1\nHEIGHT 2\nPOINTS 2\nDATA binary\r\n";
    let cloud = read_pcd(&with_header(head, &body)).unwrap();
    assert_eq!(cloud.points, [[1.25, -3.0, 200.0], [2.5, 4.0, 0.0]]);
}

#[test]
fn a_list_of_points_is_refused_with_its_height() {
    let bytes = with_header(
        "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA ascii\n",
        b"1 2 3\n4 5 6\n",
    );
    let refused = read_pcd(&bytes).unwrap().into_grid().unwrap_err();
    assert_eq!(refused, PcdError::Unorganised { height: 1, width: 2 });
    assert!(refused.to_string().contains("HEIGHT is 1"));
}

#[test]
fn truncated_data_name_both_sizes() {
    let mut bytes = write_pcd(&small_grid(), Encoding::Binary);
    bytes.truncate(bytes.len() - 5);
    let wrong = PcdError::Truncated { encoding: "binary", expected: 72, found: 67 };
    assert_eq!(read_pcd(&bytes).unwrap_err(), wrong);
    let mut bytes = write_pcd(&small_grid(), Encoding::Ascii);
    bytes.truncate(bytes.len() - 12);
    assert!(matches!(read_pcd(&bytes), Err(PcdError::Text { point: 5, .. })));
}

#[test]
fn a_huge_claim_is_refused_without_allocating_it() {
    for data in ["ascii", "binary", "binary_compressed"] {
        let head = format!(
            "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 4294967296\nHEIGHT 4294967295\n\
             POINTS 18446744069414584320\nDATA {data}\n"
        );
        assert!(read_pcd(&with_header(&head, &[0; 64])).is_err(), "{data}");
    }
}

#[test]
fn header_faults_name_the_line() {
    let head = "FIELDS x y z\nSIZE 4 4 3\nTYPE F F F\nWIDTH 1\nHEIGHT 2\nPOINTS 2\nDATA ascii\n";
    let message = read_pcd(head.as_bytes()).unwrap_err().to_string();
    assert!(message.starts_with("header line 2: SIZE is `4 4 3`"), "{message}");
    let head = "FIELDS x y\nSIZE 4 4\nTYPE F F\nWIDTH 1\nHEIGHT 2\nPOINTS 2\nDATA ascii\n";
    let message = read_pcd(head.as_bytes()).unwrap_err().to_string();
    assert_eq!(message, "no field `z` among FIELDS x y");
    assert_eq!(read_pcd(b"hello\n").unwrap_err(), PcdError::NoData { searched: 6 });
}

proptest! {
    #[test]
    fn a_damaged_file_never_panics(
        which in 0_usize..3,
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in any::<prop::sample::Index>(),
    ) {
        let encoding = [Encoding::Ascii, Encoding::Binary, Encoding::BinaryCompressed][which];
        let mut bytes = write_pcd(&small_grid(), encoding);
        for (at, value) in damage {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        let _ = read_pcd(&bytes);
        bytes.truncate(cut.index(bytes.len()));
        let _ = read_pcd(&bytes);
    }

    #[test]
    fn a_hostile_header_never_panics(
        fields in "[xyz a]{0,12}",
        sizes in prop::collection::vec(prop_oneof![Just(4_u64), any::<u64>()], 0..5),
        counts in prop::collection::vec(prop_oneof![Just(1_u64), any::<u64>()], 0..5),
        width in any::<u64>(),
        height in any::<u64>(),
        data in prop::sample::select(vec!["ascii", "binary", "binary_compressed", "?"]),
        body in prop::collection::vec(any::<u8>(), 0..200),
    ) {
        let join = |numbers: &[u64]| {
            numbers.iter().map(u64::to_string).collect::<Vec<_>>().join(" ")
        };
        let head = format!(
            "FIELDS {fields}\nSIZE {}\nTYPE F F F\nCOUNT {}\nWIDTH {width}\nHEIGHT {height}\n\
             DATA {data}\n",
            join(&sizes), join(&counts)
        );
        let _ = read_pcd(&with_header(&head, &body));
    }
}
