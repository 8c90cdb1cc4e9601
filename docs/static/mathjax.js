/* Formulas by the MathJax 2.7 beside this file, which the build takes from Debian's libjs-mathjax. */
window.MathJax = {
    showMathMenu: false,
    messageStyle: "none",
    tex2jax: { inlineMath: [["\\(", "\\)"]], displayMath: [["\\[", "\\]"]], processClass: "math", ignoreClass: "body" },
    SVG: { font: "TeX", linebreaks: { automatic: true } },
};
{
    const script = document.createElement("script");
    script.src = new URL("mathjax/MathJax.js?config=TeX-AMS_SVG", document.currentScript.src);
    document.head.append(script);
}
