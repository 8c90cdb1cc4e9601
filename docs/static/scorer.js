/* Order of the results of a search: pages whose title has the words first, and practice before
   theory, the reference and benchmarks. The other values are those of Sphinx. */
var Scorer = {
    score: ([page, title, anchor, , score]) => {
        const query = new URLSearchParams(window.location.search).get("q") || "";
        const words = query.toLowerCase().split(/\s+/).filter(Boolean);
        const stems = words.map((word) => (word.length > 3 ? word.replace(/s$/, "") : word));
        const said = title.toLowerCase().split(/[^\w]+/);
        const inTitle = stems.filter((stem) => said.some((word) => word.startsWith(stem)));
        const folders = { how_to: 6, theory: 3, benchmarks: -4, api: -2, tutorials: 2 };
        const folder = folders[page.split("/")[0]] ?? 4;
        return score + (20 * inTitle.length) / stems.length + folder - (anchor ? 1 : 0);
    },
    objNameMatch: 11,
    objPartialMatch: 6,
    objPrio: { 0: 15, 1: 5, 2: -5 },
    objPrioDefault: 0,
    title: 15,
    partialTitle: 7,
    term: 5,
    partialTerm: 2,
};
