// The sums of openmm_exactrb.mathematics.elliptic.RULES over the nodes of Gauss's rules with 6 and 10 nodes on [-1, 1].

#define SIX_NODES ( \
    REAL(0.46791393457269104)*integrand(REAL(0.056939115967007355)*u, x, z, b) \
    +REAL(0.3607615730481387)*integrand(REAL(0.4371978527510939)*u, x, z, b) \
    +REAL(0.17132449237917027)*integrand(REAL(0.8694993949182622)*u, x, z, b))
#define TEN_NODES ( \
    REAL(0.2955242247147528)*integrand(REAL(0.022163568807217638)*u, x, z, b) \
    +REAL(0.2692667193099965)*integrand(REAL(0.18783156765244552)*u, x, z, b) \
    +REAL(0.219086362515982)*integrand(REAL(0.46159736149626673)*u, x, z, b) \
    +REAL(0.1494513491505804)*integrand(REAL(0.7483346283872805)*u, x, z, b) \
    +REAL(0.06667134430868814)*integrand(REAL(0.9484939262883687)*u, x, z, b))
