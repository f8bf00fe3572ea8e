//! Groups of cameras that pairs connect.

/// Connected components of `n` cameras, in the order of their first cameras, each in ascending order. A camera without a pair is a
/// group of its own.
pub fn connected_groups(n: usize, pairs: impl IntoIterator<Item = [usize; 2]>) -> Vec<Vec<usize>> {
    let mut first_of: Vec<usize> = (0..n).collect();
    for pair in pairs {
        let [a, b] = pair.map(|camera| first_of[camera]);
        first_of.iter_mut().filter(|first| **first == a.max(b)).for_each(|first| *first = a.min(b));
    }
    let group = |first: usize| (first..n).filter(|&camera| first_of[camera] == first).collect();
    (0..n).filter(|&camera| first_of[camera] == camera).map(group).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chains_of_pairs_are_one_group() {
        assert_eq!(connected_groups(6, [[4, 2], [5, 1], [2, 0], [4, 0]]), [vec![0, 2, 4], vec![1, 5], vec![3]]);
        assert_eq!(connected_groups(4, [[2, 3], [0, 1], [1, 2]]), [[0, 1, 2, 3]]);
        assert_eq!(connected_groups(0, []), Vec::<Vec<usize>>::new());
    }
}
